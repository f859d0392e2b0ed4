"""One frozen object with every hyperparameter of an adaptation run, and the presets smoke, cpu and paper."""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.own_code import RESNETS, use_backbone
from gelgap.assets.names import unknown_name
from gelgap.assets.settings import PresetSettings

Span = Annotated[float, Field(ge=1, le=150)]
Side = Annotated[int, Field(ge=32)]


class Profile(PresetSettings):
    """Network, input, optimiser, schedule and splits of a run; `settings` holds what a single method needs.

    A TOML file's `base` names the preset whose values hold where it gives none.
    """

    model_config = ConfigDict(use_attribute_docstrings=True)
    preset_kind: ClassVar[str] = "profiles"

    name: str = "custom"
    """name under which results are filed"""
    backbone: str = "resnet18"
    """feature extractor: resnet18, resnet50, or your own as FILE.py:FUNCTION (in a file, beside it)"""
    # With fewer than 8 channels, oneDNN's strided 1×1 convolutions (torch 2.13) write past their buffer on AVX2.
    width: float = Field(default=1.0, ge=0.125, le=2)
    """factor on the number of channels (64, 128, 256, 512) of the backbone's layers"""
    feature_dim: int = Field(default=256, ge=2, le=4096)
    """size of the transfer feature"""
    image_size_px: tuple[Side, Side] = (64, 48)
    """width and height of the network's pictures, px"""
    pairing: Literal["channels", "stack", "difference"] = "channels"
    """contact and reference picture as 6 channels, one above the other, or their difference"""
    input: str = Field(default="pictures", json_schema_extra={"enum": list(INPUTS)})
    """what the network is shown of them: pictures (as paired), standardised, calibrated, grey, markers, touch or
    pretrained"""
    levelling: bool = Field(default=False, exclude_if=lambda value: not value)
    """whether each picture's channels are brought to its reference's light, by what the contact leaves unchanged"""
    marker_span_mm: tuple[Span, Span] = Field(
        default=(12.0, 9.0), exclude_if=lambda value: value == (12.0, 9.0)
    )
    """width and height of the gel, mm, that the input markers shows around the sensor's centre, 1 to 150"""
    sequence_length: int = Field(default=1, ge=1, le=16, exclude_if=lambda value: value == 1)
    """how many frames of a trajectory, up to the one that is labelled, the network is shown as channels of one picture,
    1 to 16; its first frame is repeated before it"""
    batch_size: int = Field(default=32, ge=2, le=4096)
    """frames of each domain in a step"""
    source_epochs: int = Field(default=20, ge=1)
    """epochs of stage 1 (source regression only)"""
    source_learning_rate: float = Field(default=0.1, gt=0)
    """initial learning rate of stage 1"""
    adapt_epochs: int = Field(default=10, ge=1)
    """epochs of stage 2; an epoch is one pass over the source"""
    adapt_learning_rate: float = Field(default=0.01, gt=0)
    """initial learning rate of stage 2"""
    backbone_rate_factor: float = Field(default=0.1, gt=0, le=1)
    """learning rate of the backbone over the heads'"""
    momentum: float = Field(default=0.9, ge=0, lt=1)
    """momentum of SGD"""
    weight_decay: float = Field(default=5e-4, ge=0)
    """weight decay of SGD"""
    rate_decay: float = Field(default=3e-4, ge=0)
    """a in the learning rate's factor (1 + a·step)^−b"""
    rate_power: float = Field(default=0.75, ge=0)
    """b in the learning rate's factor (1 + a·step)^−b"""
    final_fall: float = Field(default=0.0, ge=0, le=1)
    """share of a stage's steps, its last ones, over which the learning rate also falls linearly to zero"""
    averaging: float = Field(default=0.0, ge=0, lt=1)
    """share of the averaged weights that a step keeps; the average is the result of a stage; 0: the last weights are"""
    regression_weight: float = Field(default=1.0, ge=0)
    """λ_r of stage 2"""
    classification_weight: float = Field(default=1.0, ge=0)
    """λ_c of stage 2, for methods with a classifier"""
    classification_feedback: float = Field(default=1.0, ge=0, le=1)
    """share of the classification gradient that reaches the features (the paper: 1); the classifier itself learns at
    full weight"""
    transfer_weight: float = Field(default=1.0, ge=0)
    """λ_t of stage 2 when the ramp has ended"""
    transfer_warmup: float = Field(default=0.0, ge=0, lt=1)
    """share of stage 2 with λ_t = 0, in which the classifier learns"""
    transfer_ramp: float = Field(default=10.0, ge=0)
    """γ of λ_t's ramp 2/(1+e^(−γp))−1 over the steps after the warm-up; 0: no ramp"""
    colour_mixing: float = Field(default=0.0, ge=0, le=1)
    """share of source frames whose colours are turned at random, a stand-in for other lights"""
    marker_hiding: float = Field(default=0.0, ge=0, le=1)
    """share of training batches shown with their markers inpainted, in stage 2 the target's too"""
    shift_px: int = Field(default=0, ge=0, le=64)
    """training pictures of both domains are shifted at random by up to this many pixels, a stand-in for contacts
    elsewhere"""
    batch_statistics: Literal["joint", "mixed", "per_domain"] = "joint"
    """stage 2 normalises source and target as one batch, or each by itself; then both are judged under the running
    statistics of the two (mixed), or each under its own (per_domain)"""
    source_holdout: float = Field(default=0.1, ge=0, lt=1)
    """share of the source kept out of training to measure source risk"""
    target_split: tuple[float, float, float] = (0.6, 0.2, 0.2)
    """target shares for training (unlabelled), validation and test"""
    split_by: str = "random"
    """split at random by the run's seed, by contact point so that no near-duplicate crosses it, as the data set states
    it (given), or by a column of the data such as clip or object"""
    stratify_by: str | None = Field(default=None, exclude_if=lambda value: value is None)
    """column of the data of which every part of a split gets its share of each value"""
    precision: Literal["float32", "bfloat16"] = "float32"
    """of the backbone's arithmetic"""
    threads: int = Field(default=1, ge=1, le=256)
    """CPU threads of one run"""
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """by method: settings of the method that differ from its defaults"""

    @field_validator("backbone")
    @classmethod
    def _is_known(cls, name: str) -> str:
        if not re.fullmatch(r"[\w.-]+:\w+#[0-9a-f]*", name) and name not in RESNETS:
            raise ValueError(
                "must be resnet18, resnet50 or your own, FILE.py:FUNCTION (in Python what use_backbone returns)"
            )
        return name

    @field_validator("target_split")
    @classmethod
    def _adds_up(cls, shares: tuple[float, float, float]) -> tuple[float, float, float]:
        if min(shares) <= 0 or abs(sum(shares) - 1) > 1e-6:
            raise ValueError("must be three positive shares that add up to 1")
        return shares

    @model_validator(mode="after")
    def _shows_what_it_can(self) -> "Profile":
        if self.shift_px and self.pairing == "stack":
            raise ValueError("shift_px: must be 0 with pairing 'stack', whose reference is below the picture")
        if (shown := INPUTS.get(self.input)) is None:
            raise ValueError(unknown_name("input", self.input, INPUTS))
        if shown.needs_difference and self.pairing != "difference":
            raise ValueError(f"input {self.input}: needs pairing 'difference', not {self.pairing!r}")
        if shown.channels is not None and self.colour_mixing:
            raise ValueError(f"input {self.input}: has no colours to mix; colour_mixing must be 0")
        if shown.find is not None and self.marker_hiding:
            raise ValueError(
                f"input {self.input}: shows no pictures with and without markers; marker_hiding must be 0"
            )
        if shown.from_touch and self.shift_px:
            raise ValueError(f"input {self.input}: shows how far a dent is off its place; shift_px must be 0")
        return self

    @property
    def in_channels(self) -> int:
        """Channels of one frame of the network's input."""
        return INPUTS[self.input].channels or (6 if self.pairing == "channels" else 3)

    @property
    def input_shape(self) -> tuple[int, int, int]:
        """Channels of all frames of a sequence, height and width of the network's input."""
        width, height = self.image_size_px
        return self.sequence_length * self.in_channels, height * (2 if self.pairing == "stack" else 1), width

    @property
    def needs_trajectories(self) -> bool:
        """Whether a frame is shown with what came before it."""
        return self.sequence_length > 1 or INPUTS[self.input].from_touch

    @property
    def judges_by_own_statistics(self) -> bool:
        """Whether stage 2 ends with batch statistics estimated on the domain that is judged, not the running ones."""
        return self.batch_statistics == "per_domain"

    def replace(self, **changes: Any) -> "Profile":
        """Return a checked copy with some fields changed."""
        return Profile(**(self.model_dump() | changes))

    @classmethod
    def _of_table(cls, values: dict[str, Any], name: str, folder: Path) -> Self:
        base = values.pop("base", None)
        start = {} if base is None else cls.preset(base).model_dump()
        backbone = str(values.get("backbone", ""))
        if ":" in backbone:
            values["backbone"] = use_backbone(str(folder / backbone) if ".py:" in backbone else backbone)
        return super()._of_table(start | {"name": name} | values, name, folder)
