"""What training uses of the machine: device, threads, precision, and memory that is kept between steps."""

import contextlib
import ctypes
import functools
from collections.abc import Iterator

import torch

from gelgap.adapt.profile import Profile

# Options of glibc's mallopt.
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3


def best_device() -> torch.device:
    """Return the GPU if there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def autocast(profile: Profile, device: torch.device) -> torch.autocast:
    """Return the context in which the backbone computes in the profile's precision."""
    return torch.autocast(device.type, torch.bfloat16, enabled=profile.precision == "bfloat16")


@contextlib.contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Run with `count` CPU threads, and keep freed memory from here on."""
    keep_freed_memory()
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@functools.cache
def keep_freed_memory() -> bool:
    """Have glibc keep freed memory for the next step; return whether the C library supports this.

    By default glibc maps and unmaps every activation above 128 kB anew, and each step zeroes all their pages again.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    # 32 MiB is the highest threshold that glibc takes; larger blocks are always mapped.
    options = {_M_MMAP_THRESHOLD: 2**25, _M_TRIM_THRESHOLD: 2**31 - 1, _M_TOP_PAD: 2**26}
    accepted = [set_option(option, value) for option, value in options.items()]
    return all(accepted)
