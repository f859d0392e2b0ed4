"""Network inputs from labelled frames: contact and reference picture paired and normalised, a batch at a time."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

Pairing = Literal["channels", "stack", "difference"]
Batch = tuple[Tensor, Tensor, Tensor]

# Statistics of ImageNet, on which published backbones were trained.
_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)
# Pressing changes a channel by a tenth or two of its range; the gain brings the input near unit size.
_DIFFERENCE_GAIN = 4.0


class PairedFrames(Dataset):
    """Inputs (C, h, w) float32 from a picture and its reference, labels (k,) such as forces in N, contact classes.

    With a and r the contact and the reference picture in [0, 1]: `channels` puts the normalised r behind the normalised
    a (6 channels), `stack` below it (3 channels, twice the height, as the paper's code does); `difference` is 4·(a − r)
    (3 channels).

    Pictures stay uint8 on the device until they are used: a domain of 10,830 frames at 256 px takes 2.1 GB, so that it
    fits in the memory of the machine or the GPU and no step waits for data.

    Parameters
    ----------
    images, references
        (n, h, w, 3) and (r, h, w, 3) uint8 RGB.
    label_values, contact_class
        (n, k), each label in its unit, and (n,) integers, −1 unknown.
    pairing
        How the reference is given.
    device
        Where pictures and labels are kept.
    reference_id
        (n,) which reference is a frame's own; by default the first.
    """

    def __init__(
        self,
        images: np.ndarray,
        references: np.ndarray,
        label_values: np.ndarray,
        contact_class: np.ndarray,
        pairing: Pairing = "channels",
        device: torch.device | str = "cpu",
        reference_id: np.ndarray | None = None,
    ):
        if pairing not in get_args(Pairing):
            raise ValueError(f"pairing {pairing!r} is unknown; known: {', '.join(get_args(Pairing))}")
        self.pairing = pairing
        self.images = torch.from_numpy(images).to(device)
        self.label_values = torch.from_numpy(label_values.astype(np.float32)).to(device)
        self.contact_class = torch.from_numpy(contact_class.astype(np.int64)).to(device)
        self._references = torch.from_numpy(references.copy()).to(device)
        # A single reference needs no copy for each frame.
        self._reference_id = (
            None if len(references) == 1 else torch.from_numpy(reference_id.astype(np.int64)).to(device)
        )

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> Batch:
        inputs, forces, classes = self.batch([index])
        return inputs[0], forces[0], classes[0]

    def batch(self, indices: Sequence[int] | np.ndarray | Tensor) -> Batch:
        """Return inputs (B, C, h, w) float32, labels (B, k) and contact classes (B,) of these frames."""
        rows = torch.as_tensor(indices, device=self.images.device)
        return self.inputs(rows), self.label_values[rows], self.contact_class[rows]

    def inputs(self, indices: Sequence[int] | np.ndarray | Tensor) -> Tensor:
        """Return the network's inputs (B, C, h, w) float32 for these frames, channels last in memory."""
        rows = torch.as_tensor(indices, device=self.images.device)
        own = self._references if self._reference_id is None else self._references[self._reference_id[rows]]
        return self.pair(self.images[rows], own, self.pairing)

    @staticmethod
    def pair(images: Tensor, references: Tensor, pairing: Pairing) -> Tensor:
        """Return inputs (B, C, h, w) of images (B, h, w, 3) and one reference (1, h, w, 3), or one each, uint8."""
        # All arithmetic is on (…, h, w, 3) as stored, which is a network's layout "channels last". Statistics per
        # pixel are faster than three numbers, along whose short axis nothing is vectorised.
        pictures, own = (values.float().div_(255) for values in (images, references))
        if pairing == "difference":
            return pictures.sub_(own).mul_(_DIFFERENCE_GAIN).permute(0, 3, 1, 2)
        mean, std = (
            pictures.new_tensor(one).expand(pictures.shape[1:]).contiguous() for one in (_MEAN, _STD)
        )
        pictures, own = (values.sub_(mean).div_(std) for values in (pictures, own))
        dim = 3 if pairing == "channels" else 1
        return torch.cat([pictures, own.expand_as(pictures)], dim).permute(0, 3, 1, 2)

    def loader(
        self, batch_size: int = 32, shuffle: bool = True, seed: int = 0, workers: int = 0
    ) -> DataLoader:
        """Return a DataLoader of whole batches, shuffled by `seed`."""
        order = torch.Generator().manual_seed(seed)
        # It draws indices, and a batch is made of them at once: much faster than frame by frame.
        return DataLoader(
            range(len(self)),
            batch_size,
            shuffle=shuffle,
            generator=order,
            num_workers=workers,
            collate_fn=self.batch,
        )
