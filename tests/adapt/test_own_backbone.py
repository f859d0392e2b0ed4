"""A feature extractor of one's own: trained, kept, and run only where the user names its file."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from network_weights import weights
from picture_folders import forces_of, write_pictures

from gelgap.adapt import ForceModel, Profile, adapt, own_code, train_source, use_backbone
from gelgap.adapt.network import OwnBackbone
from gelgap.cli.main import main

FILE = """from pathlib import Path

from torch import nn

Path("ran").touch()


def maps(channels):
    return nn.Sequential(nn.Conv2d(channels, 8, 5, 4), nn.BatchNorm2d(8), nn.ReLU())


def features(channels):
    return nn.Sequential(maps(channels), nn.Flatten(), nn.LazyLinear(12), nn.Dropout(0.5))


def nothing(channels):
    return None


def one_number(channels):
    return nn.Sequential(maps(channels), nn.Flatten(0))


number = 3
"""


@pytest.fixture(autouse=True)
def own_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(own_code, "_BACKBONES", {})
    (tmp_path / "net.py").write_text(FILE)
    return tmp_path / "net.py"


@pytest.mark.parametrize("function", ["maps", "features"])
def test_it_is_trained_adapted_kept_and_loaded_when_its_file_is_named(
    function, source, target, profile, own_file, monkeypatch, caplog
):
    own = profile.replace(backbone=use_backbone(f"net.py:{function}"), source_epochs=2, adapt_epochs=1)
    adapted, again = (adapt(train_source(source, own), source, target, "dann") for _ in range(2))
    np.testing.assert_array_equal(weights(adapted), weights(again))
    adapted.save("model.pt")
    started = train_source(target, own, weights="model.pt")
    assert started.profile.backbone.startswith(f"net.py:{function}#")

    monkeypatch.setattr(own_code, "_BACKBONES", {})
    own_file.with_name("ran").unlink()
    with pytest.raises(ValueError, match=rf"model\.pt: the network has the feature ext.* net\.py:{function}"):
        ForceModel.load("model.pt")
    assert not Path("ran").exists()
    loaded = ForceModel.load("model.pt", f"net.py:{function}")
    np.testing.assert_array_equal(loaded.predict_n(target), adapted.predict_n(target))
    assert not caplog.messages

    other = own_file.parent / "other" / "net.py"
    other.parent.mkdir()
    other.write_text(FILE + "# changed\n")
    ForceModel.load("model.pt", f"other/net.py:{function}")
    assert f"feature extractor net.py:{function} is not that with which" in caplog.messages[0]


def test_the_name_holds_no_folder_and_changes_with_the_code(own_file, profile):
    first = profile.replace(backbone=use_backbone("net.py:maps"))
    (own_file.parent / "other").mkdir()
    copied = shutil.copy(own_file, own_file.parent / "other" / "net.py")
    assert use_backbone(str(copied) + ":maps") == first.backbone
    Path(copied).write_text(FILE.replace("8, 5, 4", "8, 5, 2"))
    changed = use_backbone(f"{copied}:maps")
    assert changed != first.backbone
    assert own_code.own_backbone(changed)(3)[0].stride == (2, 2)


def test_a_profile_finds_the_file_beside_it_and_the_command_line_takes_it(own_file, source, capsys, refused):
    (own_file.parent / "net.toml").write_text('base = "smoke"\nbackbone = "net.py:maps"\n')
    assert Profile.load("net.toml").backbone == use_backbone("net.py:maps")
    write_pictures(own_file.parent / "real", source, **forces_of(source))
    (own_file.parent / "short.toml").write_text(
        'base = "smoke"\nsource_epochs = 1\nimage_size_px = [40, 32]\n'
    )
    given = ["--target", "real", "--method", "source-only", "--profile", "short.toml", "--out", "runs"]
    main(["adapt", "--source", "real", *given, "--set", "backbone=net.py:maps"])
    (record,) = Path("runs").glob("*/run.json")
    assert json.loads(record.read_text())["profile"]["backbone"] == use_backbone("net.py:maps")
    model = str(record.with_name("model.pt"))
    command = ["predict", model, "real/0.png", "--reference", "real/reference.png"]
    main([*command, "--backbone", "net.py:maps", "--out", "found.csv"])
    assert Path("found.csv").read_text().startswith("picture,fx_n,fy_n,fz_n,note\nreal/0.png,")
    main(["export-model", model, "-o", "model.onnx", "--backbone", "net.py:maps"])
    assert "wrote model.onnx: picture and reference of 40×32 px" in capsys.readouterr().out
    assert "has the backbone net.py:maps#" in refused(*command, "--backbone", "net.py:features")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "absent.py:maps",
            r"backbone 'absent\.py:maps': absent\.py could not be run \(FileNot",
        ),
        ("net.py:number", "number is not a function of"),
        ("net.py:nothing", "it makes NoneType, not a torch.nn.Module"),
        ("net.py:one_number", r"returns \(\d+,\) for 2 pictures \(3, 32, 40\); \(2, features\) or"),
        ("vgg", "backbone 'vgg' is unknown; known: resnet18, resnet50, FILE.py:FUNCTION"),
        (
            "torch.nn:Linear",
            r"'torch\.nn:Linear' has left: gelgap 0\.3\.0 .* name its file, FILE.py:FUNCTION",
        ),
    ],
)
def test_what_is_no_feature_extractor_is_refused(name, message, profile):
    with pytest.raises(ValueError, match=message):
        OwnBackbone(profile.replace(backbone=use_backbone(name)).backbone, profile.input_shape)


def test_a_profile_takes_no_name_whose_code_was_not_named_by_the_user(profile):
    with pytest.raises(ValueError, match=r"backbone = 'net\.py:maps': must be resnet18, resnet50 or"):
        profile.replace(backbone="net.py:maps")
    assert not Path("ran").exists()


def test_what_needs_a_resnet_says_so(profile, source, stage1):
    own = profile.replace(backbone=use_backbone("net.py:maps"), source_epochs=1)

    torch.save(stage1.network.backbone.state_dict(), "weights.pt")
    with pytest.raises(ValueError, match=r"weights\.pt is not a gelgap checkpoint: a feature extractor"):
        train_source(source, own, weights="weights.pt")
    stage1.save("resnet.pt")
    with pytest.raises(ValueError, match=r"resnet\.pt has the backbone resnet18, not net\.py:maps"):
        ForceModel.load("resnet.pt", "net.py:maps")
