"""Levelled pictures are the same whatever the light, and a contact does not change what is taken for the light."""

import numpy as np
import pytest
from conftest import draw_domain
from hypothesis import given
from hypothesis import strategies as st

from gelgap.data import ArrayFrames
from gelgap.data.frames.levelling import levelled, light_of


def lit_unevenly() -> np.ndarray:
    """A reference (48, 64, 3) between 60 and 180 codes, with dark markers."""
    y, x = np.mgrid[0:48, 0:64]
    shade = 120 + 40 * np.sin(x / 20)[..., None] * np.array([1, -0.5, 0.8]) + 20 * np.cos(y / 15)[..., None]
    shade[(y % 8 < 2) & (x % 8 < 2)] *= 0.4
    return np.rint(shade).astype(np.uint8)


def pressed(reference: np.ndarray, share: float) -> np.ndarray:
    """A picture of which a disc of this share has another colour."""
    y, x = np.mgrid[0 : reference.shape[0], 0 : reference.shape[1]]
    inside = np.hypot(x - 30, y - 20) < np.sqrt(share * reference[..., 0].size / np.pi)
    picture = reference.astype(float)
    picture[inside] += np.array([50, -30, 20])
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


@given(
    gain=st.tuples(*[st.floats(0.75, 1.15)] * 3),
    offset=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    share=st.floats(0.0, 0.3),
)
def test_the_light_is_found_beside_a_contact(gain, offset, share):
    reference = lit_unevenly()
    relit = np.clip(np.rint(pressed(reference, share) * np.array(gain) + np.array(offset)), 0, 255).astype(
        np.uint8
    )
    found_gain, found_offset = light_of(relit[None], reference)
    at_rest = reference * np.array(gain) + np.array(offset)
    # Codes are rounded, and dark markers cut off at 0; the disc differs by 20 to 50.
    assert np.abs(reference * found_gain[0] + found_offset[0] - at_rest).max() < 3.0


@pytest.mark.parametrize(
    "relight", [lambda codes: 0.8 * codes, lambda codes: codes + 3, lambda codes: codes * [1.02, 1, 0.98]]
)
def test_pictures_in_another_light_are_levelled_to_the_same(relight):
    reference = lit_unevenly()
    picture = pressed(reference, 0.15)
    relit = np.clip(np.rint(relight(picture.astype(float))), 0, 255).astype(np.uint8)
    apart = levelled(relit[None], reference).astype(float) - levelled(picture[None], reference)
    assert np.abs(apart).max() <= 2


def test_a_picture_of_its_own_reference_stays():
    reference = lit_unevenly()
    assert np.array_equal(levelled(reference[None], reference)[0], reference)


def test_a_flat_or_clipped_channel_tells_a_gain_or_nothing():
    flat = np.dstack([np.full((24, 32), value, np.uint8) for value in (100, 200, 255)])
    gain, offset = light_of((flat * [0.9, 1.1, 1.0]).astype(np.uint8)[None], flat)
    assert gain[0] == pytest.approx([0.9, 1.1, 1.0], abs=0.005)
    assert not offset.any()


def test_frames_are_levelled_by_the_reference_of_their_own():
    frames = draw_domain("drawn", n=12)
    dimmed = ArrayFrames(
        "dimmed",
        (frames.images() * 0.9).astype(np.uint8),
        frames.reference,
        frames.force_n,
        frames.contact_class,
    )
    assert np.abs(dimmed.levelled.images().astype(int) - frames.levelled.images()).max() <= 3
    assert np.array_equal(dimmed.levelled.take(np.array([3])).picture(0), dimmed.levelled.picture(3))
    assert dimmed.levelled.digest != dimmed.digest
    assert dimmed.levelled.levelled is dimmed.levelled
