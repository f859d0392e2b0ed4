"""One run of the adaptation benchmark and its record, and what its scripts share.

A run is a setting: a method on a group of a data set with a seed. `adapt_run` trains it and returns the results for its
record. A script is a grid of settings (`measure`) and tables of the records (`tables`); `run_script` gives it a command
line. All scripts keep their records in one file, so that none repeats a run of another.
"""

import datetime
import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import tyro

from gelgap.adapt import ForceModel, Profile, split_for_training
from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.methods.registry import find_method, method_code, use_method
from gelgap.adapt.result_table import ResultTable
from gelgap.adapt.runs import METHODS_VERSION, Group, Stage1, versions
from gelgap.adapt.split import SplitFrames
from gelgap.assets.checksums import canonical_json, sha256
from gelgap.assets.locks import counted_stops, key_lock
from gelgap.benchmarks.adaptation import protocol
from gelgap.benchmarks.common import Results, Setting, read_records, run_missing
from gelgap.data import LabelledFrames, join_domains, open_domain
from gelgap.data.frames.stored import GeneratedDomain
from gelgap.domains import DomainRecipe, generate_recipes
from gelgap.domains.measured_gap import recipe_of

RUNS, PROFILE = "runs.jsonl", "benchmark"
OUT = Path("benchmark-results/adaptation") / PROFILE
_BAD_INPUT, _INTERRUPTED = 2, 130
_SHOWN = (*protocol.SHOWABLE, *protocol.DRAWN_LIGHTS)
_CONTROLS = {"adabn": protocol.PLAIN, "no-transfer": "adabn", "classifier-only": "no-transfer"}
_RUN = ("source", "target", "method", "seed", "data", "changes", "settings")


def grid(
    cases: Iterable[tuple[str, protocol.Group]],
    methods: Iterable[str],
    seeds: Iterable[int],
    changes: protocol.Changes = protocol.BY_POINT,
) -> list[Setting]:
    """Return the runs of methods on data sets and groups, one seed after the other, so that finished seeds are whole.

    Of a seed, all groups come with the first method before the next one: they train the stages that others share.
    `changes` are fields of the profile that differ from the preset.
    """
    cases, methods = list(cases), list(methods)
    return [
        {
            "source": source,
            "target": target,
            "method": method,
            "seed": seed,
            "data": data,
            "changes": changes,
            "settings": (),
        }
        for seed in seeds
        for method in methods
        for data, (source, target) in cases
    ]


def upper_bounds_of(runs: list[Setting]) -> list[Setting]:
    """Return the upper bounds of the targets of runs: training on themselves, on the same input."""
    targets = dict.fromkeys((run["target"], run["seed"], run["changes"]) for run in runs)
    bounds: list[Setting] = []
    for target, seed, changes in targets:
        bounds += grid([(protocol.DATA, (target, target))], [protocol.PLAIN], [seed], changes)
    return bounds


@dataclass(frozen=True)
class Study:
    """Where runs find their data and leave their records, with which profile, and how much time they may take now.

    Without `seeds`, `methods`, `groups` or `inputs` a script takes its own; methods may be classes of one's own,
    `FILE.py:CLASS`. `workers` are processes, by default one per core; one means this process. No run
    is begun after `stop`, a time of `time.time`.
    """

    data: Path
    out: Path
    profile: str
    seeds: tuple[int, ...] = ()
    workers: int | None = None
    stop: float = math.inf
    methods: tuple[str, ...] = ()
    groups: tuple[protocol.Group, ...] = ()
    inputs: tuple[str, ...] = ()

    @classmethod
    def at(cls, folder: Path, **limits: Any) -> "Study":
        """Return the study of a folder that is named after the profile, its data beside it."""
        return cls(folder.parent / f"data-{folder.name}", folder, folder.name, **limits)

    def known_methods(self) -> tuple[str, ...]:
        """Return the chosen methods, each after its controls; one's own are known now, and read no target labels."""
        found: list[str] = []
        for method in map(use_method, self.methods):
            if find_method(method).uses_target_labels and method != protocol.UPPER_BOUND:
                raise ValueError(f"--methods {method}: it learns from the target's labels")
            own = [method]
            while control := control_of(own[0]):
                own.insert(0, control)
            found += own
        return tuple(dict.fromkeys(found))

    def generate(self, recipes: Sequence[DomainRecipe], data: str = "paired") -> None:
        """Generate what is missing of some domains of a data set, if there are any."""
        if not recipes:
            return
        scheduler = "synchronous" if self.workers == 1 else None
        report = generate_recipes(recipes, self.data / data, scheduler=scheduler, workers=self.workers)
        print(report, flush=True)

    def generate_for(self, runs: Iterable[Setting]) -> None:
        """Generate what is missing of the domains of runs; lights like a target's are drawn by its picture."""
        by_role = [run for run in runs if run["data"] in protocol.BY_ROLE]
        as_source = dict.fromkeys(run["source"] for run in by_role if run["source"] != run["target"])
        drawn = [name for name in as_source if name.startswith(protocol.RANDOM_LIGHTS)]
        recipes = protocol.role_recipes(dict.fromkeys(run["target"] for run in by_role), "target")
        self.generate(recipes, f"{protocol.DATA}-target")
        lone = [name for name in as_source if name not in drawn]
        self.generate(protocol.role_recipes(lone, "source"), f"{protocol.DATA}-source")
        for name in drawn:
            target = name.removeprefix(protocol.LIKE) if name.startswith(protocol.LIKE) else None
            pictured = target and _domain((self.data / f"{protocol.DATA}-target" / target).resolve())
            self.generate(protocol.random_light_recipes(pictured), f"{protocol.DATA}-source")
        for contacts, folder in dict(pair for run in by_role for pair in self.touches_of(run)).items():
            recipe = recipe_of(contacts)
            touches = recipe.model_copy(update={"path": protocol.touch_path(recipe.path)})
            self.generate([touches], folder.parent.name)

    def run(
        self, runs: Iterable[Setting], function: "Callable[[Study, Setting], Results] | None" = None
    ) -> pd.DataFrame:
        """Do the runs that have no record yet, by `adapt_run` or another function; return the records of the finished.

        Raises
        ------
        ValueError
            If a record is of another profile, configuration or settings than the same run has now.
        """
        return run_missing(
            partial(_run, function or adapt_run, self),
            runs,
            self.out / RUNS,
            workers=self.workers,
            fixed=self.stated_of,
            describe=self.describe,
            stop=self.stop,
        )

    @staticmethod
    def describe(record: Results) -> str:
        """Return why a run stopped, or else its mean error."""
        return record["problem"] or f"{np.mean(record['mae_n']):.3f} N"

    def profile_of(self, run: Setting) -> Profile:
        """Return the preset with the changes of a run; of the methods' settings its own alone."""
        profile, method = Profile.preset(self.profile), run["method"]
        own = profile.settings.get(method)
        return profile.replace(**dict(run["changes"]), settings={method: own} if own else {})

    def domains_of(self, run: Setting) -> list[GeneratedDomain]:
        """Return the source of a run, or its several domains in random light, and last the target."""
        folder, source, target = (self.data / run["data"]).resolve(), run["source"], run["target"]
        if run["data"] not in protocol.BY_ROLE:
            return [_domain(folder / name) for name in (source, target)]
        as_source, as_target = (folder.with_name(f"{protocol.DATA}-{role}") for role in protocol.ROLES)
        if source == target:  # for the upper bound it is trained on its own contact points
            return [_domain(as_target / target)] * 2
        own = [as_source / source]
        if not own[0].is_dir():
            own = sorted(as_source.glob(f"{source}-*"))
        return [*map(_domain, own), _domain(as_target / target)]

    def touches_of(self, run: Setting) -> list[tuple[GeneratedDomain, Path]]:
        """Return each of `domains_of` and where its points' touches are, if the input of a run begins with them."""
        found = self.domains_of(run) if INPUTS[self.profile_of(run).input].from_touch else []
        folders = [(domain, *domain.folder.parts[-2:]) for domain in found]
        return [(domain, self.data / f"{data}-touches" / name) for domain, data, name in folders]

    def frames_of(self, run: Setting) -> SplitFrames:
        """Return the frames of a run, divided for training and judging: the same contacts, whatever is shown."""
        *sources, stored = self.domains_of(run)
        target: LabelledFrames = stored
        if run["data"] == protocol.LABEL_SHIFT:
            target = protocol.with_shifted_labels(stored)
        source = sources[0] if len(sources) == 1 else join_domains(sources)
        return split_for_training(source, target, self.profile_of(run).replace(input="pictures"), run["seed"])

    def stated_of(self, run: Setting) -> Results:
        """Return what the record of a run states of its profile, its method and its data."""
        profile, method = self.profile_of(run), run["method"]
        domains = [*self.domains_of(run), *(_domain(folder) for _, folder in self.touches_of(run))]
        data = [(recipe_of(domain).key, domain.digest) for domain in domains]
        return {
            "profile": self.profile,
            "configuration": configuration_of(profile, *data),
            "settings": profile.settings.get(method, {}),
            "code_sha256": method_code(method),
        }

    def stage1(self, run: Setting, source_train: LabelledFrames) -> Stage1:
        """Return the first stage of a run, whose checkpoint all methods of a group, split and seed share."""
        return Stage1(source_train, self.profile_of(run), run["seed"], None, self.out)


def train_once(stage1: Stage1, method: str) -> float:
    """Train the first stage that a method needs, or wait until another has; return its processor time now, s."""
    if not find_method(method).needs_stage_1:
        return 0.0
    with key_lock(stage1.checkpoint.parent, stage1.checkpoint.name):
        return stage1.model()[1]


def configuration_of(profile: Profile, *data: Any) -> str:
    """Return a hash of what methods share: version of the training, profile without settings, recipe and files of data.

    The files hold labels and pictures, so that pictures of another processor are another configuration.
    """
    common = profile.model_dump(mode="json", exclude={"name", "settings"}, exclude_defaults=True)
    return sha256(canonical_json([METHODS_VERSION, common, *data]))[:12]


@cache
def _domain(folder: Path) -> GeneratedDomain:
    domain = open_domain(folder)
    if not isinstance(domain, GeneratedDomain):
        raise ValueError(f"{folder} is no domain that gelgap generated")
    return domain


def begun_by_touches(frames: SplitFrames, source: LabelledFrames, target: LabelledFrames) -> SplitFrames:
    """Return all parts with the touches of their points at the end: a point is a trajectory that its touch begins.

    Source and target hold the touches, which do not count where frames are judged: they have no force there.
    """
    parts: dict[str, LabelledFrames] = {}
    for name, contacts in frames.parts.items():
        touches = target if name.startswith("target") else source
        touches = touches.take(np.isin(touches.point_id, contacts.point_id))
        parts[name] = join_domains([contacts, touches])
        columns = parts[name].columns
        columns |= {"trajectory_id": columns["point_id"], "reference_id": np.zeros(len(parts[name]), int)}
        # A touch comes after the first frame of all, which is without contact.
        columns["step"] = np.append(2 * contacts.columns["frame_id"], np.ones(len(touches), int))
        if not name.endswith("train"):
            for axis in contacts.labels.names:
                columns[axis][len(contacts) :] = np.nan
    return replace(frames, **parts)


def _run(function: Callable[[Study, Setting], Results], study: Study, run: Setting) -> Results:
    study.known_methods()  # a worker process does not know them yet
    return function(study, run)


def adapt_run(study: Study, run: Setting) -> Results:
    """Train both stages of a run; return what its record needs, with errors on the target's test frames, by axis.

    A run that stopped with a problem (its features collapsed, or its losses were not finite) has no model, and counts
    with the errors of the source's mean force. Times are the processor's; `stage1_s` is 0 where another run had trained
    the checkpoint.
    """
    frames = study.frames_of(run)
    touches = [_domain(folder) for _, folder in study.touches_of(run)]
    shown = begun_by_touches(frames, *touches) if touches else frames
    stage1 = study.stage1(run, shown.source_train)
    stage1_s = train_once(stage1, run["method"])
    done, model = Group(shown, stage1).run(run["method"])
    return {
        "versions": "gelgap {gelgap}, torch {torch}".format_map(versions()),
        "when": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "control": control_of(run["method"]),
        "problem": done.problem,
        "mae_n": short(done.target_test.mae_n),
        "r2": short(done.target_test.r2),
        "constant_mean_n": short(done.target_constant_mean.mae_n),
        "source_held_out_r2": done.source_held_out and short(done.source_held_out.r2),
        "stage1_s": round(stage1_s, 2),
        "stage2_s": round(done.core_s["stage2"], 2),
        "skipped_steps": done.skipped_steps,
        "diagnostics": short(done.history[-1].get("diagnostics", {}) if done.history else {}),
        "baselines_mae_n": {name: short(error.mae_n) for name, error in done.baselines.items()},
        "baselines_r2": {name: short(error.r2) for name, error in done.baselines.items()},
        "frames_sha256": {name: part.digest for name, part in frames.parts.items()},
        "stage1_sha256": state_digest(stage1.model()[0])
        if find_method(run["method"]).needs_stage_1
        else None,
        # A run that stopped counts with the source's mean force.
        "predicted_n": (
            np.broadcast_to(frames.source_train.force_n.mean(axis=0), frames.target_test.force_n.shape)
            if model is None
            else model.predict_n(shown.target_test)[: len(frames.target_test)]
        ).astype(np.float32),
    }


def state_digest(model: ForceModel) -> str:
    """Return the SHA-256 of a model's weights and running statistics: who has the same starts where this run did."""
    state = model.network.state_dict().items()
    return sha256(b"".join(name.encode() + own.cpu().contiguous().numpy().tobytes() for name, own in state))


def control_of(method: str) -> str | None:
    """Return the method that a method must beat for its loss to be of use; None for source-only and the upper bound.

    Class-aware methods are compared with the classifier without a loss, source-free ones with AdaBN, others with stage
    2 without a loss.
    """
    found = find_method(method)
    if method in _CONTROLS or not found.uses_target or found.uses_target_labels:
        return _CONTROLS.get(method)
    return "classifier-only" if found.uses_classifier else "no-transfer"


def short(values: Mapping[str, float] | Iterable[float]) -> Any:
    """Return values rounded to five digits, so that records stay small."""
    if isinstance(values, Mapping):
        return dict(zip(values, short(values.values()), strict=True))
    return [float(f"{value:.5g}") for value in values]


def load_runs(file: Path) -> pd.DataFrame:
    """Return the records of a file of runs, with what each shows (`protocol.shown_in`) and errors (`with_errors`)."""
    records = with_errors(read_records(file))
    pairs = zip(records["source"], records["changes"], strict=True)
    return records.assign(shown=[protocol.shown_in(source, changes) for source, changes in pairs])


def with_errors(records: pd.DataFrame) -> pd.DataFrame:
    """Return records with their group ("mb0i0 → wmb1i1"), MAE (N) and R² by axis, and the mean MAE over the axes, N."""
    if records.empty:
        records = pd.DataFrame(columns=[*_RUN, "problem", "alarm", "mae_n", "r2"])
    of_axes = {f"MAE {axis}, N": records["mae_n"].str[i] for i, axis in enumerate(protocol.AXES)}
    of_axes |= {f"R² {axis}": records["r2"].str[i] for i, axis in enumerate(protocol.AXES)}
    group = records["source"] + " → " + records["target"]
    shear = records["mae_n"].map(lambda mae_n: float(np.mean(mae_n[:2])))
    return records.assign(group=group, error_n=records["mae_n"].map(np.mean), shear_n=shear, **of_axes)


@dataclass(frozen=True)
class Choices:
    """What a script of the benchmark takes from the command line."""

    seeds: tuple[int, ...] = ()
    """By default the script's own."""
    methods: tuple[str, ...] = ()
    """Names, or your own as module:Class or file.py:Class, each with its controls; by default the script's own."""
    groups: tuple[Literal[*protocol.KNOWN_GROUPS], ...] = ()  # type: ignore[valid-type]  # tyro reads them when it runs
    """SOURCE:TARGET; by default the script's own."""
    inputs: tuple[Literal[*_SHOWN], ...] = ()  # type: ignore[valid-type]  # tyro reads them when it runs
    """What networks are shown, or the random lights of their source. For `touch` a straight touch of each point comes
    first, which is not judged."""
    workers: int | None = None
    """Processes; by default one per core."""
    minutes: float = math.inf
    """Begin no run after this time; the next call goes on."""
    out: Path = OUT
    """Folder of the records, named after the profile; its data lie beside it."""
    table: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Print the tables of a file of records in Markdown, and measure nothing."""

    def study(self) -> Study:
        """Return the study that was chosen."""
        groups = tuple(protocol.KNOWN_GROUPS[group] for group in self.groups)
        chosen = {"seeds": self.seeds, "methods": self.methods, "groups": groups, "inputs": self.inputs}
        return Study.at(self.out, workers=self.workers, stop=time.time() + 60 * self.minutes, **chosen)


def run_script(
    name: str,
    description: str | None,
    measure: Callable[[Study], None],
    tables: Callable[[pd.DataFrame], list[ResultTable]],
    takes: Sequence[str] = ("seeds", "methods", "groups"),
) -> None:
    """Do what the command line asks of a script; bad input and Ctrl-C end with one sentence.

    `takes` names the choices by which a user can narrow what is measured.
    """
    with counted_stops() as stops:
        try:
            choices = tyro.cli(
                Choices, prog=f"python -m gelgap.benchmarks.adaptation.{name}", description=description
            )
            if choices.table is not None:
                if not choices.table.is_file():
                    raise ValueError(f"--table {choices.table}: no such file")
                print("\n".join(table.markdown() for table in tables(load_runs(choices.table))))
                return
            for other in {"seeds", "methods", "groups", "inputs"} - set(takes):
                if getattr(choices, other):
                    raise ValueError(
                        f"--{other} does not narrow this script; it takes --{', --'.join(takes)}"
                    )
            study = choices.study()
            measure(study)
            for table in tables(load_runs(study.out / RUNS)):
                table.show()
        except (KeyboardInterrupt, Exception) as error:
            if stops:  # some libraries turn Ctrl-C into an error of their own
                text = "interrupted; finished runs are kept, run the same command again to go on"
                print(text, file=sys.stderr)
                sys.exit(_INTERRUPTED)
            if not isinstance(error, ValueError):
                raise
            print(" ".join(str(error).split()), file=sys.stderr)
            sys.exit(_BAD_INPUT)
