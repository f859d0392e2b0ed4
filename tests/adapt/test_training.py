"""Two-stage training: it learns, is deterministic, resumes, keeps target pictures apart, names its errors."""

import copy
import re
import resource
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
import torch
from network_weights import weights
from torch.optim.optimizer import register_optimizer_step_pre_hook

from gelgap.adapt.data import (
    Draw,
    TrainingDomain,
    epoch_order,
    network_inputs,
    normalised_labels,
    steps_per_epoch,
)
from gelgap.adapt.evaluation import as_judged_on_source, evaluate, evaluate_constant_mean
from gelgap.adapt.methods.base import Method
from gelgap.adapt.methods.registry import OWN_METHODS, OwnMethod, find_method, make_method, method_names
from gelgap.adapt.model import ForceModel, estimate_statistics
from gelgap.adapt.network import ForceNetwork
from gelgap.adapt.profile import Profile
from gelgap.adapt.report import write_report
from gelgap.adapt.run_record import load_predictions, load_runs
from gelgap.adapt.runs import adapt_folders, run_key, stage1_key, stage1_profile
from gelgap.adapt.split import split_for_training
from gelgap.adapt.trainer import adapt, batches_of, train_source, untrained
from gelgap.data import ArrayFrames, join_domains


def altered(frames: ArrayFrames, **changes: np.ndarray) -> ArrayFrames:
    """Return the frames with some arrays changed."""
    names = ("force_n", "contact_class", "point_id", "reference")
    arrays = {"images": frames.images()} | {name: getattr(frames, name) for name in names}
    return ArrayFrames(frames.name, **(arrays | changes))


def test_stage_1_learns(stage1, source, target, profile):
    frames = split_for_training(source, target, profile, 0)
    error = evaluate(stage1, frames.source_held_out).mean_mae_n
    assert error < 0.6 * evaluate_constant_mean(frames.source_train, frames.source_held_out).mean_mae_n


def test_same_seed_same_weights_another_seed_others(source, profile):
    short = profile.replace(source_epochs=2)
    first = train_source(source, short, seed=3)
    torch.rand(7)
    np.testing.assert_array_equal(weights(first), weights(train_source(source, short, seed=3)))
    assert np.abs(weights(first) - weights(train_source(source, short, seed=4))).max() > 1e-3


def test_the_learning_rate_falls_by_the_schedule(source, profile):
    rates = []
    falling = profile.replace(source_epochs=2, rate_decay=0.5, rate_power=0.75, final_fall=0.4)
    noting = register_optimizer_step_pre_hook(
        lambda optimizer, *_: rates.append([group["lr"] for group in optimizer.param_groups])
    )
    try:
        train_source(source, falling)
    finally:
        noting.remove()
    step = np.arange(len(rates))
    expected = falling.source_learning_rate * (1 + 0.5 * step) ** -0.75
    expected *= np.minimum(1, (1 - step / len(rates)) / 0.4)
    assert len(rates) > 8
    for of_group in zip(*rates, strict=True):
        assert of_group == pytest.approx(expected)


def test_no_transfer_takes_only_normalisation_from_the_target(stage1, source, target):
    profile = stage1.profile.replace(batch_statistics="per_domain")
    other = altered(target, images=target.images()[::-1].copy() // 2)
    first, second = (adapt(stage1, source, t, "no-transfer", profile) for t in (target, other))
    for (name, one), two in zip(first.network.named_parameters(), second.network.parameters(), strict=True):
        torch.testing.assert_close(one, two, rtol=0, atol=0, msg=name)
    assert np.abs(first.predict_n(target) - second.predict_n(target)).max() > 1e-3
    assert np.abs(weights(first) - weights(stage1)).max() > 1e-3


@pytest.mark.parametrize(
    ("statistics", "method", "shown"),
    [("per_domain", "no-transfer", 1), ("per_domain", "dan", 2), ("mixed", "no-transfer", 2)],
)
def test_stage_2_shows_the_network_a_target_only_if_that_changes_something(
    stage1, source, target, monkeypatch, statistics, method, shown
):
    trained, features = [], ForceNetwork.features

    def noting(network, pictures):
        trained.append(torch.is_grad_enabled())
        return features(network, pictures)

    monkeypatch.setattr(ForceNetwork, "features", noting)
    profile = stage1.profile.replace(batch_statistics=statistics, adapt_epochs=1)
    adapt(stage1, source, target, method, profile)
    assert sum(trained) == shown * steps_per_epoch(len(source), profile.batch_size)


def test_mixed_statistics_are_those_of_both_domains_in_turn(stage1, source, target):
    still = stage1.profile.replace(batch_statistics="mixed", adapt_learning_rate=1e-12, adapt_epochs=1)
    adapted = adapt(stage1, source, target, "no-transfer", still)
    network = copy.deepcopy(stage1.network).train()
    pictures = [network_inputs(frames, still, "cpu") for frames in (source, target)]
    keys = (0, Draw.STAGE_2, 0), (0, Draw.STAGE_2_TARGET, 0)
    orders = [epoch_order(len(source), still.batch_size, *key) for key in keys]
    with torch.no_grad():
        for rows in zip(*orders, strict=True):
            for domain, of_domain in zip(pictures, rows, strict=True):
                network(domain.inputs(of_domain))
    expected, found = network.state_dict(), adapted.network.state_dict()
    statistics = [name for name in expected if name.endswith(("running_mean", "running_var"))]
    assert statistics
    for name in statistics:
        torch.testing.assert_close(found[name], expected[name], rtol=1e-4, atol=1e-6)


def test_a_smaller_target_is_cycled_on_from_epoch_to_epoch(source, target, profile):
    """Five epochs of six batches are six passes over a target of five."""
    small = altered(target.take(np.arange(80)), contact_class=np.arange(80))
    domains = [TrainingDomain(frames, profile, "cpu", labelled=True) for frames in (source, small)]
    batches = [of_target for epoch in range(5) for _, of_target in batches_of(epoch, *domains, profile, 0)]
    shown = torch.cat([batch.contact_class for batch in batches])
    assert torch.bincount(shown).tolist() == 80 * [6]


def test_with_mixed_statistics_both_domains_are_judged_by_one_model(stage1, source, target):
    mixed = stage1.profile.replace(batch_statistics="mixed")
    adapted = adapt(stage1, source, target, "no-transfer", mixed)
    assert as_judged_on_source(adapted, source) == adapted
    own = replace(adapted, profile=mixed.replace(batch_statistics="per_domain"))
    assert np.abs(as_judged_on_source(own, source).predict_n(source) - adapted.predict_n(source)).max() > 1e-3


def test_the_paper_profile_has_the_published_statistics():
    assert Profile.preset("paper").batch_statistics == "mixed"


def test_classifier_only_trains_what_dsan_trains_without_its_loss(stage1, source, target):
    weightless = stage1.profile.replace(transfer_weight=0.0)
    without, dsan = (adapt(stage1, source, target, m, weightless) for m in ("classifier-only", "dsan"))
    np.testing.assert_array_equal(weights(without), weights(dsan))
    plain = adapt(stage1, source, target, "no-transfer", weightless)
    assert np.abs(weights(without) - weights(plain)).max() > 1e-4


class Hidden(ArrayFrames):
    """Frames whose pictures may not be looked at."""

    def load(self, size_px, markers):
        raise AssertionError("these pictures were used")


def test_source_only_never_sees_target_pictures(stage1, source, target):
    hidden = Hidden(target.name, target.images(), target.reference, target.force_n)
    adapt(stage1, source, hidden, "source-only")
    with pytest.raises(AssertionError, match="these pictures were used"):
        adapt(stage1, source, hidden, "adabn")


@pytest.mark.parametrize("method", [m for m in method_names() if not find_method(m).uses_target_labels])
def test_a_method_repeats_itself_without_a_look_at_target_labels(stage1, source, target, method):
    short = stage1.profile.replace(adapt_epochs=1)
    lied = altered(
        target,
        force_n=np.full_like(target.force_n, np.nan),
        contact_class=np.full_like(target.contact_class, -1),
        point_id=np.full_like(target.point_id, -1),
    )
    honest = weights(adapt(stage1, source, target, method, short))
    np.testing.assert_array_equal(honest, weights(adapt(stage1, source, lied, method, short)))
    assert np.isfinite(honest).all()
    assert np.any(honest != weights(stage1)) == (method != "source-only")


def test_a_full_disk_is_named(source, profile, tmp_path):
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, most[1]))
    try:
        with pytest.raises(RuntimeError, match=r"cannot write .*resume\.pt: File too large"):
            train_source(source, profile, 0, resume_file=tmp_path / "resume.pt")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    assert not list(tmp_path.iterdir())


def test_resumed_training_gives_the_same_bytes(source, profile, tmp_path):
    three = profile.replace(source_epochs=3)
    whole = train_source(source, three, seed=0)

    class Killed(Exception):
        pass

    def kill(title, done, total, message):
        if done == 2:
            raise Killed

    with pytest.raises(Killed):
        train_source(source, three, 0, resume_file=tmp_path / "resume.pt", progress=kill)
    resumed = train_source(source, three, 0, resume_file=tmp_path / "resume.pt")
    np.testing.assert_array_equal(weights(whole), weights(resumed))
    assert len(resumed.history) == 3


def test_checkpoint_round_trip(stage1, source, tmp_path):
    stage1.save(tmp_path / "model.pt")
    loaded = ForceModel.load(tmp_path / "model.pt")
    np.testing.assert_array_equal(loaded.predict_n(source), stage1.predict_n(source))
    assert loaded.profile == stage1.profile
    started = train_source(source, stage1.profile.replace(source_epochs=1), 5, weights=tmp_path / "model.pt")
    assert evaluate(started, source).mean_mae_n < 2 * evaluate(stage1, source).mean_mae_n
    with pytest.raises(ValueError, match="trained with another network"):
        train_source(source, stage1.profile.replace(width=0.25), weights=tmp_path / "model.pt")
    torch.save({"a": 1}, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="is not a gelgap checkpoint"):
        ForceModel.load(tmp_path / "other.pt")
    with pytest.raises(FileNotFoundError, match=r"missing\.pt"):
        ForceModel.load(tmp_path / "missing.pt")


def test_a_domain_of_one_frame_is_an_error(stage1, source, target):
    one = np.arange(1)
    with pytest.raises(ValueError, match=r"mb0i0: 1 frame\(s\); training needs at least 2"):
        train_source(source.take(one), stage1.profile)
    with pytest.raises(ValueError, match=r"wmb1i1: 1 frame\(s\); training"):
        adapt(stage1, source, target.take(one), "dan")


def test_label_outside_the_declared_range_is_an_error(source, profile):
    force = source.force_n.copy()
    force[5, 0] = 0.9
    with pytest.raises(ValueError, match=r"frame 5, Fx = 0\.9 N, allowed \[-0\.75, 0\.75\] N"):
        train_source(altered(source, force_n=force), profile)


def test_pictures_of_another_size_are_resized_and_too_small_ones_are_an_error(stage1, source, target, caplog):
    small = altered(target, images=target.images()[:, :, :32], reference=target.reference[:, :32])
    with pytest.raises(ValueError, match="pictures are 32×32 px and are only down-sampled"):
        adapt(stage1, source, small, "adabn")
    with pytest.raises(ValueError, match="pictures are 32×32 px and are only down-sampled"):
        adapt_folders(source, small, ["constant-mean"], stage1.profile)
    large = altered(
        target,
        images=target.images().repeat(2, axis=1).repeat(2, axis=2),
        reference=target.reference.repeat(2, axis=0).repeat(2, axis=1),
    )
    same, resized = (adapt(stage1, source, frames, "adabn") for frames in (target, large))
    np.testing.assert_array_equal(weights(same), weights(resized))
    np.testing.assert_array_equal(same.predict_n(target), resized.predict_n(large))
    adapt_folders(source, large, ["constant-mean"], stage1.profile)
    assert not caplog.messages
    tall = altered(
        target, images=target.images().repeat(2, axis=1), reference=target.reference.repeat(2, axis=0)
    )
    adapt_folders(source, tall, ["constant-mean"], stage1.profile)
    assert "40×32 px and those of wmb1i1 40×64 px" in caplog.messages[0]
    caplog.clear()
    adapt_folders(join_domains([tall, source]), target, ["constant-mean"], stage1.profile)
    assert ["pictures of wmb1i1 are 40×64 px" in note for note in caplog.messages] == [True]
    with pytest.raises(ValueError, match="pictures are 32×32 px and are only down-sampled"):
        adapt_folders(join_domains([source, small]), target, ["constant-mean"], stage1.profile)


def test_unknown_method_lists_the_known_ones(stage1, source, target):
    with pytest.raises(ValueError, match=r"method 'dann2' is unknown; known methods: .*source-only.*dsan"):
        adapt(stage1, source, target, "dann2")


def test_source_frames_of_one_class_are_too_few(source, target, profile):
    one_class = source.take(np.flatnonzero(source.contact_class == source.contact_class[0]))
    model = train_source(source, profile.replace(source_epochs=1))
    with pytest.raises(
        ValueError, match=r"dsan needs source frames of at least 2 contact classes, and the \d+ of"
    ):
        adapt(model, one_class, target, "dsan")


@pytest.fixture
def own_method(monkeypatch):
    """Make a class known as the method of a file."""
    return lambda name, kind: monkeypatch.setitem(OWN_METHODS, name, OwnMethod(kind, "code"))


def test_own_method(stage1, source, target, own_method):
    class MeanMatching(Method):
        """Squared distance of the feature means."""

        def transfer_loss(self, source, target):
            return (source.features.mean(dim=0) - target.features.mean(dim=0)).square().sum()

    own_method("mean-matching", MeanMatching)
    model = adapt(stage1, source, target, "mean-matching")
    assert "transfer" in model.history[-1]["losses"]


def test_a_method_is_asked_before_it_is_made(stage1, source, target, own_method):
    class Late(Method):
        def __init__(self, *given):
            super().__init__(*given)
            self.uses_target_labels = True

    class Hooked(Method):
        def augment_source(self, inputs, target, step):
            return inputs

    own_method("late", Late)
    with pytest.raises(ValueError, match="method late: uses_target_labels must be an attribute of the class"):
        adapt(stage1, source, target, "late")
    own_method("hooked", Hooked)
    with pytest.raises(ValueError, match=r"augment_source' has left: gelgap 0\.3\.0 is the last version"):
        adapt(stage1, source, target, "hooked")


def test_an_own_adaptation_is_given_pictures_alone(stage1, source, target, own_method):
    class Peeping(Method):
        def adapt(self, adaptation):
            shown = adaptation.target_pictures()
            pictures = target.torch(stage1.profile.image_size_px, stage1.profile.pairing)
            assert torch.equal(shown.inputs(np.arange(5)), pictures.inputs(np.arange(5)))
            assert len(shown) == len(target)
            assert shown.pictures.label_values.shape == (len(target), 0)
            assert np.array_equal(adaptation.source_labels, normalised_labels(source))
            seen.append(shown)

    own_method("peeping", Peeping)
    seen = []
    adapt(stage1, source, target, "peeping")
    assert len(seen) == 1


def test_a_source_among_several_that_is_the_target_is_refused_where_its_test_frames_would_be_trained_on(
    source, target, profile
):
    both = join_domains([source, target])
    with pytest.raises(ValueError, match="target wmb1i1 is a source too: split_by must be point or a column"):
        split_for_training(both, target, profile, 0)
    frames = split_for_training(both, target, profile.replace(split_by="point"), 0)
    assert not set(frames.source_train.point_id) & set(frames.target_test.point_id)


def test_a_loss_that_is_not_finite_is_counted_and_then_an_error(stage1, source, target, own_method):
    class Broken(Method):
        calls = 0

        def transfer_loss(self, source, target):
            Broken.calls += 1
            return source.features.sum() * (float("nan") if Broken.calls <= bad else 0.0)

    own_method("broken", Broken)
    bad = 3
    model = adapt(stage1, source, target, "broken")
    assert sum(record["skipped_steps"] for record in model.history) == 3
    assert np.isfinite(weights(model)).all()
    bad = 10**6
    with pytest.raises(RuntimeError, match="20 steps in a row had a loss or gradient that is not finite"):
        adapt(stage1, source, target, "broken", stage1.profile.replace(adapt_epochs=5))


def test_a_method_that_collapses_is_recorded_and_the_others_go_on(
    source, target, profile, tmp_path, own_method
):
    class Collapsing(Method):
        def transfer_loss(self, source, target):
            return 1e3 * source.features.var(dim=0).sum()

    own_method("collapsing", Collapsing)
    long = profile.replace(adapt_epochs=10)
    methods = ["adabn", "collapsing", "source-only"]
    runs = adapt_folders(source, target, methods, long, out_dir=tmp_path)
    assert [run.method for run in runs] == methods
    assert [run.problem is None for run in runs] == [True, False, True]
    assert re.search("features collapsed.*lower transfer_weight", runs[1].problem)
    assert runs[1].target_test == runs[1].target_constant_mean
    assert runs[1].source_held_out is None
    assert adapt_folders(source, target, methods, long, out_dir=tmp_path, progress=pytest.fail) == runs
    with pytest.raises(RuntimeError, match=r"collapsing has no predictions: .*features collapsed"):
        load_predictions(runs[1])
    report = unescape(write_report(tmp_path).read_text())
    assert "Failed, and counted with the source's mean force: collapsing on mb0i0 → wmb1i1, seed 0" in report


def test_runs_are_folders_and_nothing_is_computed_twice(source, target, short, tmp_path):
    runs = adapt_folders(source, target, ["source-only", "dsan"], short, out_dir=tmp_path)
    assert runs[1].core_s["stage1"] == 0
    again = adapt_folders(source, target, ["source-only", "dsan"], short, out_dir=tmp_path)
    assert again == runs
    assert sorted(run.method for run in load_runs(tmp_path)) == ["dsan", "source-only"]
    arrays = load_predictions(runs[1])
    mae = np.abs(arrays["target_true_n"] - arrays["target_predicted_n"]).mean(axis=0)
    np.testing.assert_allclose(mae, runs[1].target_test.mae_n, rtol=1e-4)
    assert arrays["target_features"].shape[1] == short.feature_dim
    with pytest.raises(FileNotFoundError, match="holds no finished adaptation run"):
        load_runs(tmp_path / "stage1")


def test_the_key_knows_the_methods_own_settings_alone(source, target, profile):
    heavier = profile.replace(settings={"dsan": {"transfer_weight": 0.5}})
    frames = split_for_training(source, target, profile, 0)
    keys = {
        (method, p is heavier): run_key(frames, method, p, 0)
        for method in ("dsan", "adabn")
        for p in (profile, heavier)
    }
    assert keys["dsan", True] != keys["dsan", False]
    assert keys["adabn", True] == keys["adabn", False]
    assert stage1_profile(heavier) == stage1_profile(profile.replace(adapt_epochs=7))
    assert stage1_profile(profile.replace(source_epochs=7)) != stage1_profile(profile)


def test_the_key_knows_the_split(source, target, profile):
    splits = [split_for_training(source, target, profile, seed) for seed in (0, 1)]
    assert run_key(splits[0], "dsan", profile, 0) != run_key(splits[1], "dsan", profile, 0)
    keys = {stage1_key(frames.source_train, profile, 0) for frames in splits}
    assert len(keys) == 2


def test_a_split_by_point_is_shared_by_both_domains(source, target, profile):
    frames = split_for_training(source, target, profile.replace(split_by="point"), 0)
    seen, test = (set(part.point_id.tolist()) for part in (frames.source_train, frames.target_test))
    assert test
    assert not seen & test
    assert len(frames.source_train) + len(frames.source_held_out) == len(source)


def test_two_runs_into_one_folder_are_not_mixed(source, target, profile, tmp_path):
    short = profile.replace(source_epochs=2, adapt_epochs=2)
    refused = []

    def intrude(title, done, total, message):
        for method in ("dsan", "adabn"):
            with pytest.raises(RuntimeError, match=r"another process \(pid \d+\) is writing to"):
                adapt_folders(source, target, [method], short, out_dir=tmp_path)
            refused.append(title)
            if not title.startswith("source"):
                break

    runs = adapt_folders(source, target, ["dsan"], short, out_dir=tmp_path, progress=intrude)
    assert refused == 4 * ["source mb0i0"] + 2 * ["dsan mb0i0 → wmb1i1"]
    assert adapt_folders(source, target, ["dsan"], short, out_dir=tmp_path) == runs


def test_another_method_joins_while_stage_2_runs(source, target, short, tmp_path):
    joined = []

    def join(title, done, total, message):
        if title.startswith("dsan"):
            joined.extend(adapt_folders(source, target, ["adabn"], short, out_dir=tmp_path))

    adapt_folders(source, target, ["dsan"], short, out_dir=tmp_path, progress=join)
    assert [run.method for run in joined] == ["adabn"]
    assert joined[0].core_s["stage1"] == 0
    assert len(load_runs(tmp_path)) == 2


def test_without_a_folder_stage_1_is_trained_once(source, target, short):
    titles = []
    methods = ["source-only", "adabn", "adabn"]
    runs = adapt_folders(source, target, methods, short, progress=lambda title, *_: titles.append(title))
    assert titles == 2 * ["source mb0i0"]
    assert [run.method for run in runs] == methods


def test_a_wrong_setting_of_a_method_is_an_error_before_any_work(source, target, profile):
    low = r"settings of method daregram: threshold = -1\.0: input should be greater"
    for name, message in (("daregram", low), ("dare-gram", "method 'dare-gram' is unknown")):
        wrong = profile.replace(settings={name: {"threshold": -1.0}})
        with pytest.raises(ValueError, match=message):
            adapt_folders(source, target, ["source-only", "daregram"], wrong, progress=pytest.fail)


@pytest.mark.parametrize("name", ["smoke", "cpu", "benchmark", "paper"])
def test_presets(name):
    profile = Profile.preset(name)
    assert profile.name == name
    make_method("dsan", profile, 361)


def test_bad_profiles():
    with pytest.raises(
        ValueError, match=r"profile preset 'big' is unknown; known presets: benchmark, cpu, paper, smoke"
    ):
        Profile.preset("big")
    with pytest.raises(ValueError, match=r"'board' has left: gelgap 0\.3\.0 .*; it is called benchmark"):
        Profile.preset("board")
    with pytest.raises(ValueError, match="add up to 1"):
        Profile(target_split=(0.6, 0.3, 0.3))
    with pytest.raises(ValueError, match=r"image_size_px.0 = 16: input should be greater than"):
        Profile(image_size_px=(16, 16))


def test_normalisation_statistics_are_of_every_picture(source, profile, monkeypatch):
    shown = []
    monkeypatch.setattr("gelgap.adapt.model.update_bn", lambda batches, network: shown.extend(batches))
    estimate_statistics(untrained(source, profile).network, source, profile, seed=0)
    assert [len(batch) for batch in shown] == [48, 48]


def test_the_source_is_judged_under_its_own_statistics(source, target, profile):
    per_domain = profile.replace(batch_statistics="per_domain")
    plain, adabn = adapt_folders(source, target, ["source-only", "adabn"], per_domain)
    assert adabn.source_held_out.mean_mae_n < 1.3 * plain.source_held_out.mean_mae_n
    assert adabn.source_held_out.mean_mae_n < 0.6 * adabn.source_constant_mean.mean_mae_n
