"""What a trainer relies on, for every engine; oracle: numpy indexing, and the model before."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from gscore.engine.base import Feature, RowEdit, ShUpdate, StepPhoto, StepRequest, TermKind
from gscore.engine.cpu.engine import CpuEngine
from gscore.raster.request import Frustum
from gscore.splats import PARAMETERS, Splats
from gscore.stress.capture import ToyPhotos, toy_photos, toy_splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.photos.view_sampler import training_camera
from gscore.trainer.trainer import Trainer
from tests.engine.fake_engine import FakeEngine
from tests.engine.small_engine import SmallEngine
from tests.gpu.engines import software_engine
from tests.trainer.short_run import CONFIG

Make = Callable[[], Any]
ENGINES: dict[str, Make] = {
    "cpu": CpuEngine,
    "fake": FakeEngine,
    "fake in flight": partial(FakeEngine, 2),
    "small": SmallEngine,
    "gpu": software_engine,
}
COUNTERS = ("grad2d", "views")


@pytest.fixture(scope="module")
def photos() -> ToyPhotos:
    """A capture small enough for the slowest engine."""
    return toy_photos(splats=toy_splats(count=40), size=20)


@pytest.fixture(scope="module")
def known_splats() -> Splats:
    """The splats that it was rendered from."""
    return toy_splats(count=40)


@pytest.fixture(params=ENGINES)
def make_engine(request: pytest.FixtureRequest) -> Make:
    """Makes one of the engines."""
    return ENGINES[request.param]


@pytest.fixture
def engine(make_engine: Make) -> Any:
    """Each engine."""
    return make_engine()


def columns_of(splats: Splats) -> dict[str, np.ndarray]:
    return {name: getattr(splats, name).copy() for name in PARAMETERS}


def all_of(model: Any) -> dict[str, np.ndarray]:
    """Copies of all columns."""
    return {name: model.column(name) for name in model.widths}


def view_of(photos: ToyPhotos, index: int) -> Frustum:
    cameras = photos.scene.cameras
    size = int(cameras.widths[index]), int(cameras.heights[index])
    return training_camera(cameras.viewmats[index], cameras.Ks[index], *size, 0.01)


def request_of(photos: ToyPhotos, index: int, step: int, **options: Any) -> StepRequest:
    return StepRequest(
        **{
            "step": step,
            "photo": index,
            "view": view_of(photos, index),
            "background": (0.0, 0.0, 0.0),
            "shown_background": (0.0, 0.0, 0.0),
            "sh_degree": 0,
            "sh_update": ShUpdate.STEP,
            "rates": dict.fromkeys(PARAMETERS, 1e-3),
            "terms": ((TermKind.L1, 0.8), (TermKind.SSIM, 0.2)),
            "observe": COUNTERS,
            "extent": 1.0,
        }
        | options
    )


def stepped(engine: Any, model: Any, photos: ToyPhotos, count: int) -> list[Any]:
    """The results of some steps."""
    results = []
    for step in range(1, count + 1):
        index = step % len(photos.train)
        engine.put(index, StepPhoto(image=photos.image(index)))
        results.append(engine.step(model, request_of(photos, index, step)).result())
    return results


@pytest.fixture
def model(engine: Any, known_splats: Splats) -> Any:
    """The toy scene's splats."""
    return engine.model(columns_of(known_splats), counters=COUNTERS)


def test_a_model_has_the_columns_it_was_made_of(model: Any, known_splats: Splats) -> None:
    """Oracle: the splats; counters of zeros; columns are copies."""
    for name in PARAMETERS:
        np.testing.assert_array_equal(model.column(name), getattr(known_splats, name))
        assert model.column(name).shape == (len(model), *model.widths[name])
        model.column(name)[:] = 77
        np.testing.assert_array_equal(model.column(name), getattr(known_splats, name))
    assert model.sh_degree == known_splats.sh_degree
    assert not any(model.column(name).any() for name in COUNTERS)


def test_a_step_changes_parameters_and_counters(engine: Any, model: Any, photos: ToyPhotos) -> None:
    """Oracle: the model before; finite numbers; each step counted."""
    before = all_of(model)
    results = stepped(engine, model, photos, 4)
    assert all(np.isfinite([r.loss, r.mse]).all() and not r.skipped for r in results)
    assert all(r.slopes.shape == (1, 19) for r in results)
    assert (model.column("means") != before["means"]).any()
    assert model.column("views").any()
    assert model.adam_steps["means"] == 4


def test_an_edit_is_applied_in_the_order_of_its_fields(
    engine: Any, model: Any, photos: ToyPhotos
) -> None:
    """Oracle: numpy: values, moves, then rows kept and copied by their old numbers."""
    stepped(engine, model, photos, 2)
    before, count = all_of(model), len(model)
    values = np.array([[9.0, 8.0, 7.0]], np.float32)
    changes = {"opacities": np.array([0.5, 0.25], np.float32)}
    model.edit(
        RowEdit(
            rows=np.array([1]),
            values={"means": values},
            moved=np.array([0]),
            sources=np.array([1]),
            keep=np.array([count - 1, 0, 1]),
            parents=np.array([2, 3]),
            changes=changes,
        )
    )
    assert len(model) == 5
    means = before["means"]
    expected = np.stack([means[-1], *values, *values, means[2], means[3]])
    np.testing.assert_array_equal(model.column("means"), expected)
    np.testing.assert_array_equal(model.column("opacities")[3:], changes["opacities"])
    np.testing.assert_array_equal(model.column("sh0")[3:], before["sh0"][2:4])
    expected = [before["views"][-1], 0, before["views"][1], 0, 0]
    np.testing.assert_array_equal(model.column("views"), expected)
    np.testing.assert_array_equal(
        model.gather("means", np.array([4, 0])), model.column("means")[[4, 0]]
    )


def test_wider_coefficients_are_zero(model: Any) -> None:
    """Oracle: the coefficients before, then zeros; a lower degree changes nothing."""
    before = model.column("shN")
    model.widen_sh(3)
    assert model.sh_degree == 3
    np.testing.assert_array_equal(model.column("shN")[:, : before.shape[1]], before)
    assert not model.column("shN")[:, before.shape[1] :].any()
    model.widen_sh(0)
    assert model.sh_degree == 3


def test_rows_that_are_not_finite_are_reset(model: Any) -> None:
    """Oracle: two NaN rows become finite and transparent, the others stay."""
    means = model.column("means")
    broken = means.copy()
    broken[[2, 5]] = np.nan
    model.edit(RowEdit(values={"means": broken}))
    assert model.clamp_runaways(1.0) == 2
    found = model.column("means")
    assert np.isfinite(found).all()
    assert (model.column("opacities")[[2, 5]] <= -20).all()
    rest = np.delete(np.arange(len(model)), [2, 5])
    np.testing.assert_array_equal(found[rest], means[rest])


def test_a_saved_model_goes_on_with_the_same_bits(
    engine: Any, make_engine: Make, model: Any, photos: ToyPhotos, known_splats: Splats
) -> None:
    """Oracle: the model that was not saved, after three more steps."""
    stepped(engine, model, photos, 3)
    saved = {name: array.copy() for name, array in model.save().items()}
    other = make_engine()
    loaded = other.load(saved, model.adam_steps, other.model(columns_of(known_splats)))
    for one, trained in ((engine, model), (other, loaded)):
        stepped(one, trained, photos, 3)
    for name, array in model.save().items():
        np.testing.assert_array_equal(loaded.save()[name], array, err_msg=name)


def test_drawing_changes_nothing(engine: Any, model: Any, photos: ToyPhotos) -> None:
    """Oracle: the state before; the size of the view, also of two models at once."""
    stepped(engine, model, photos, 2)
    before = {name: array.copy() for name, array in model.save().items()}
    view = view_of(photos, 0)
    for models in ([model], [model, model]):
        picture = engine.draw(
            models, view, background=(0, 0, 0), antialias=False, inverse_depth=True, scaling=0.5
        )
        assert picture.rgb.shape == (view.height, view.width, 3)
        assert picture.alpha.shape == picture.inverse_depth.shape == (view.height, view.width)
    photo, features = StepPhoto(image=photos.image(0)), engine.info.features
    if Feature.CONTRIBUTIONS in features:
        found = list(engine.contributions(model, [(view, photo)], antialias=False))
        assert found[0].kept.shape == found[0].whole.shape == (len(model),)
    if Feature.POSES in features:
        look = {"background": (0, 0, 0), "antialias": False}
        assert engine.pose_gradient([model], view, photo, **look).shape == (4, 4)
    engine.release()
    for name, array in model.save().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


def test_parts_are_the_rows(model: Any) -> None:
    """Oracle: the columns."""
    part = model.part(3, 7)
    for name in PARAMETERS:
        np.testing.assert_array_equal(part[name], model.column(name)[3:7])


def test_results_may_be_read_later(
    make_engine: Make, photos: ToyPhotos, known_splats: Splats
) -> None:
    """Oracle: the results, their numbers and the model of steps that are read at once."""
    runs = []
    for keeps in (False, True):
        engine = make_engine()
        model = engine.model(columns_of(known_splats), counters=COUNTERS)
        pending, results = [], []
        for step in range(1, 7):
            index = step % len(photos.train)
            engine.put(index, StepPhoto(image=photos.image(index)))
            pending.append(engine.step(model, request_of(photos, index, step)))
            while len(pending) > keeps * engine.in_flight:
                results.append(pending.pop(0).result())
        results += [one.result() for one in pending]
        assert [found.step for found in results] == [1, 2, 3, 4, 5, 6]
        runs.append(([(found.loss, found.mse) for found in results], all_of(model)))
    assert runs[0][0] == runs[1][0]
    for name, column in runs[0][1].items():
        np.testing.assert_array_equal(runs[1][1][name], column, err_msg=name)


def test_an_engine_says_what_it_is(engine: Any) -> None:
    """Oracle: names, positive costs and pace; closing twice is no error."""
    info = engine.info
    assert info.name and info.numerics
    assert {TermKind.L1, TermKind.SSIM} <= info.terms
    assert info.cost.step > 0 and engine.pace() > 0
    assert engine.in_flight >= 0
    engine.close()
    engine.close()


def test_a_training_runs(make_engine: Make, photos: ToyPhotos) -> None:
    """Oracle: growth in a run with refinements, the number of steps, finite splats; the same again
    from a second engine."""
    runs = []
    for one in (make_engine(), make_engine()):
        blurs = Feature.BLUR in one.info.features
        masks = Feature.MASKS in one.info.features
        config = replace(CONFIG, photo_blur=blurs, transient_masks=masks)
        trainer = Trainer(config, Analysis(photos=photos), engine=one)
        first = trainer.splat_count
        changes = [trainer.step().change for _ in range(25)]
        assert trainer.steps == 25
        assert sum(change.added for change in changes) > 0
        grown = sum(change.added - change.removed for change in changes)
        assert trainer.splat_count == first + grown
        runs.append(trainer.splats())
    for name in PARAMETERS:
        assert np.isfinite(getattr(runs[0], name)).all(), name
        np.testing.assert_array_equal(getattr(runs[0], name), getattr(runs[1], name))
