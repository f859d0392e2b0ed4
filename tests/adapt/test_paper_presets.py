"""The two presets called paper, of data and of training, fit each other."""

import numpy as np

from gelgap.adapt import Profile
from gelgap.data.formats.pictures import resized
from gelgap.domains import preset_recipes


def test_data_of_the_paper_preset_fit_the_paper_profile():
    (recipe, *_) = preset_recipes("paper")
    size_px = Profile.preset("paper").image_size_px
    across, down = np.meshgrid(np.linspace(20, 220, 320), np.linspace(40, 200, 240))
    picture = np.stack([across, down, across], axis=2).astype(np.uint8)
    assert picture.shape[1::-1] == recipe.size_px
    shown = resized(picture, size_px)
    assert shown.shape == (256, 256, 3)
    assert np.abs(shown[..., 0].mean(axis=0) - np.linspace(20, 220, 256)).max() < 1.5
    assert np.abs(shown[..., 1].mean(axis=1) - np.linspace(40, 200, 256)).max() < 1.5
