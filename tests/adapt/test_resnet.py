"""The ResNets: torchvision's keys and sizes, ImageNet weights from a file, width and input channels."""

import numpy as np
import pytest
import torch

from gelgap.adapt.network import ResNet, load_imagenet_weights
from gelgap.adapt.profile import Profile
from gelgap.adapt.runs import adapt_folders, run_key
from gelgap.adapt.split import split_for_training


@pytest.mark.parametrize(("name", "parameters"), [("resnet18", 11_176_512), ("resnet50", 23_508_032)])
def test_parameter_count_is_torchvisions_without_fc(name, parameters):
    assert sum(p.numel() for p in ResNet(name).parameters()) == parameters


def test_keys_are_torchvisions():
    keys = set(ResNet("resnet50").state_dict())
    assert {
        "conv1.weight",
        "bn1.running_var",
        "layer1.0.conv3.weight",
        "layer1.0.downsample.0.weight",
        "layer1.0.downsample.1.num_batches_tracked",
        "layer3.5.bn2.bias",
        "layer4.2.conv1.weight",
    } <= keys
    assert len(keys) == 318
    assert len(ResNet("resnet18").state_dict()) == 120
    assert "layer1.0.downsample.0.weight" not in ResNet("resnet18").state_dict()


def test_six_channels_answer_to_a_doubled_picture_as_the_original(tmp_path):
    original = ResNet("resnet18").eval()
    state = {**original.state_dict(), "fc.weight": torch.zeros(1000, 512), "fc.bias": torch.zeros(1000)}
    torch.save(state, tmp_path / "weights.pt")
    paired = ResNet("resnet18", in_channels=6).eval()
    load_imagenet_weights(paired, tmp_path / "weights.pt")
    picture = torch.rand(2, 3, 64, 64)
    torch.testing.assert_close(
        paired(torch.cat([picture, picture], dim=1)), original(picture), atol=1e-4, rtol=1e-4
    )


def test_weights_that_do_not_fit_are_refused(tmp_path):
    torch.save(ResNet("resnet18").state_dict(), tmp_path / "weights.pt")
    with pytest.raises(ValueError, match="does not fit this backbone"):
        load_imagenet_weights(ResNet("resnet50"), tmp_path / "weights.pt")
    with pytest.raises(FileNotFoundError, match=r"missing\.pt"):
        load_imagenet_weights(ResNet("resnet18"), tmp_path / "missing.pt")


def test_width_scales_the_feature():
    narrow = ResNet("resnet18", width=0.125)
    assert narrow.out_features == 64
    assert narrow(torch.rand(2, 3, 48, 64)).shape == (2, 64)


def test_networks_too_narrow_for_every_processor_are_refused():
    with pytest.raises(ValueError, match=r"width.*0\.125"):
        Profile.preset("smoke").replace(width=0.0625)


def test_paper_profile_runs_on_imagenet_weights(source, target, tmp_path):
    """Both stages of the paper's profile, three steps each: ResNet-50, bfloat16, weights from a file."""
    paper = Profile.preset("paper")
    assert (paper.backbone, paper.precision, paper.image_size_px) == ("resnet50", "bfloat16", (256, 256))
    short = paper.replace(image_size_px=(40, 32), batch_size=4, source_epochs=1, adapt_epochs=1, threads=1)
    weights = tmp_path / "resnet50.pth"
    torch.save({**ResNet("resnet50").state_dict(), "fc.weight": torch.zeros(1000, 2048)}, weights)
    few = [frames.take(np.arange(14)) for frames in (source, target)]
    (run,) = adapt_folders(*few, ["dsan"], short, weights=weights)
    assert [record["skipped_steps"] for record in run.history] == [0, 0]
    assert run.history[1]["losses"].keys() == {"regression", "classification", "transfer"}
    assert np.isfinite(run.target_test.mae_n).all()
    split = split_for_training(*few, short, 0)
    assert run_key(split, "dsan", short, 0, weights) == run.key != run_key(split, "dsan", short, 0)
