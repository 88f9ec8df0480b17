"""`--device` of the verbs; oracle: what the CPU draws, and the sentences."""

import json
from pathlib import Path

import numpy as np
import pytest

from gscore.io.cameras_json import write_cameras
from gscore.io.ply.splats import write_splats
from gscore.lod import groups
from gscore.raster.gpu import choice, gpu_raster
from gscore.raster.gpu.devices import Device
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from gscore.scene import Cameras
from gscore.splats import Splats
from tests.gpu.fake_gpu import SOFTWARE, card

VIEWS = 3


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """The folder of a model with its cameras."""
    rng = np.random.default_rng(4)
    f = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    splats = Splats(
        means=f(200, 3), quats=f(200, 4), scales=0.3 * f(200, 3) - 2, opacities=f(200),
        sh0=f(200, 1, 3), shN=0.1 * f(200, 3, 3),
    )  # fmt: skip
    viewmats = np.tile(np.eye(4), (VIEWS, 1, 1))
    viewmats[:, 2, 3] = 4 + np.arange(VIEWS)
    K = np.array([[40.0, 0, 24], [0, 40.0, 16], [0, 0, 1]])
    cameras = Cameras(
        viewmats=viewmats,
        Ks=np.tile(K, (VIEWS, 1, 1)),
        widths=np.full(VIEWS, 48),
        heights=np.full(VIEWS, 32),
        names=tuple(f"view{i}.png" for i in range(VIEWS)),
    )
    folder = tmp_path / "model"
    write_splats(folder / "point_cloud.ply", splats)
    write_cameras(folder / "cameras.json", cameras)
    return folder


@pytest.fixture
def tested(device: Device) -> Device:
    """The first device of this machine, with a verdict."""
    keep_verdict(device.key, DeviceVerdict(passed=True))
    return device


def test_render_draws_the_cpu_s_pictures(gscore, model: Path, tested: Device, tmp_path) -> None:
    """Oracle: the CPU's depth maps; the splats are copied to the device once."""
    found = {}
    for name in ("cpu", str(tested.number)):
        out = tmp_path / name
        options = ("--device", name, "--depth", "npy", "--json", "-o", out)
        code, text, err = gscore("render", model, *options)
        assert code == 0, err
        found[name] = [np.load(path) for path in sorted(out.glob("*.npy"))]
        named = json.loads(text)["device"]
        assert named == ("cpu" if name == "cpu" else tested.name)
    one, other = found.values()
    assert len(one) == len(other) == VIEWS
    assert max(np.abs(a - b).max() for a, b in zip(one, other, strict=True)) < 1e-4
    assert any(a.any() for a in one)
    assert gpu_raster.opened(tested).uploads == 1


def test_splats_of_a_level_are_copied_once(
    gscore, model: Path, tested: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the PSNR of the CPU; coarse and fine splats of a measured chunk are copied once, for
    six pictures, and no copy stays."""
    monkeypatch.setattr(groups, "MOST_IN_A_CHUNK", 50)
    found = {}
    for name in ("cpu", str(tested.number)):
        out = tmp_path / f"{name}.lod"
        code, text, err = gscore("lod", model, "--device", name, "--json", "-o", out)
        assert code == 0, err
        found[name] = json.loads(text)["levels"]
    one, other = ([level["psnr"] for level in levels[1:]] for levels in found.values())
    assert one == pytest.approx(other, abs=0.01) and None not in one and one
    raster = gpu_raster.opened(tested)
    chunks = sum(min(level["chunks"], 4) for level in found["cpu"][1:])
    assert raster.uploads == 2 * chunks and not raster._kept


def test_auto_without_a_card_is_the_cpu(gscore, model: Path, fake, tmp_path: Path) -> None:
    """Oracle: the CPU in the result and nothing on stderr, where no device is named."""
    fake(card(**SOFTWARE))
    code, text, err = gscore("render", model, "--view", "0", "--json", "-o", tmp_path / "out")
    assert code == 0 and json.loads(text)["device"] == "cpu"
    assert "CPU" not in err and "llvmpipe" not in err


@pytest.mark.parametrize("quiet", [False, True])
def test_a_self_test_is_named_where_lines_stay(
    gscore, model: Path, fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quiet: bool
) -> None:
    """Oracle: one line on stderr, none with --quiet."""

    def failing(device: Device, *, report, **_: object) -> DeviceVerdict:
        for end in ("", ": starting"):
            report(f"Testing {device.name} once, at most 60 s{end}")
        return DeviceVerdict(passed=False, problems=("black",))

    monkeypatch.setattr(choice, "verified", failing)
    fake(card())
    options = ("--device", "auto", "--view", "0", "-o", tmp_path / "out")
    code, _, err = gscore("render", model, *options, *(["--quiet"] if quiet else []))
    assert code == 0
    assert err.splitlines().count("Testing Card once, at most 60 s.") == (not quiet)
    assert err.count("Testing") == (not quiet)


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("gpu", "No graphics card can be used. There is"),
        ("4", "There is no device 4. There is"),
        ("fast", "'fast' is not cpu, gpu, auto or a number listed by gscore doctor"),
    ],
)
def test_a_device_that_cannot_draw_is_refused(
    gscore,
    model: Path,
    fake,
    tmp_path: Path,
    device: str,
    words: str,
) -> None:
    """Oracle: exit code 2, one sentence and no pictures."""
    fake(message="there is no Vulkan loader on this system")
    code, _, err = gscore("render", model, "--device", device, "-o", tmp_path / "out")
    assert code == 2 and " ".join(words.split()) in " ".join(err.split())
    assert "Traceback" not in err and not (tmp_path / "out").exists()


def test_doctor_lists_devices(gscore, fake) -> None:
    """Oracle: the devices of the fake library, in JSON and in text."""
    fake(card(), card(missing=b"Vulkan 1.2", name=b"Old"), card(**SOFTWARE))
    code, out, _ = gscore("doctor", "--json")
    facts = json.loads(out)
    assert code == 0 and [one["number"] for one in facts["devices"]] == [0, 1, 2]
    assert facts["devices"][0]["verdict"] is None and facts["devices"][0]["kind"] == "discrete"
    assert "lacks Vulkan 1.2" in facts["devices"][1]["reason"]
    assert facts["device_problems"] == []
    _, out, _ = gscore("doctor")
    text = " ".join(out.split())
    assert "device 0 Card, discrete, 24 GB, 20 GB free, driver 1.0: not tested yet" in text
    assert "device 1 Old," in text and "It lacks Vulkan 1.2" in text


def test_doctor_names_why_there_is_no_device(gscore, fake) -> None:
    """Oracle: the sentence on the missing loader; the machine can train all the same."""
    fake(message="there is no Vulkan loader on this system")
    code, out, _ = gscore("doctor")
    assert code == 0 and "graphics     There is" in out


def test_doctor_verifies(gscore, fake, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a self-test that fails, for each device that lacks nothing."""
    from gscore.commands import doctor

    tested = []

    def failing(device: Device, **options) -> None:
        assert options["again"]
        tested.append(device.number)
        keep_verdict(device.key, DeviceVerdict(passed=False, problems=("black pictures",)))

    monkeypatch.setattr(doctor, "verified", failing)
    fake(card(), card(missing=b"Vulkan 1.2", uuid=bytes(16)))
    _, out, _ = gscore("doctor", "--verify")
    assert tested == [0] and "Its self-test failed: black pictures." in " ".join(out.split())


def test_stress_measures_what_a_device_can(gscore, tested: Device) -> None:
    """Oracle: pictures, gradients, losses, trainings and extreme splats pass; threads of the CPU
    are skipped, and so are skips that only the CPU can disable."""
    measured = ("S12b", "S17", "S17b", "S22", "S25", "S29")
    keys = [word for key in (*measured, "S18") for word in ("--only", f"{key} ")]
    code, out, err = gscore("stress", "--device", str(tested.number), *keys, "--json")
    rows = json.loads(out)
    assert code == 0, err
    passed = {row["test"] for row in rows if row["passed"]}
    skipped = {row["test"]: row["note"] for row in rows if row["passed"] is None}
    assert {name.split()[0] for name in passed} == set(measured)
    words = "gradient, median", "picture, mean", "SSIM", "guard words overwritten", "mcmc, black"
    for word in words:
        assert any(word in name for name in passed), word
    assert {name.split()[0] for name in skipped} == {"S18", "S29"}
    assert set(skipped.values()) == {"skipped: measures the CPU only"}
    assert all(tested.name in row["isa"] for row in rows)


def test_bench_measures_a_device(gscore, tested: Device) -> None:
    """Oracle: counts that do not depend on the device."""
    size = ("--splats", "500", "--width", "64", "--height", "48", "--repeats", "1", "--json")
    code, out, err = gscore("bench", "raster", "--device", str(tested.number), *size)
    assert code == 0, err
    found = json.loads(out)
    _, out, _ = gscore("bench", "raster", *size)
    assert found["visible"] == json.loads(out)["visible"] and found["splats"] == 500
    assert found["total_ms"] > 0 and tested.name in found["device"]


def test_steps_are_measured_alone_and_in_flight(gscore, tested: Device) -> None:
    """Oracle: both times in JSON and text, and the name of the device."""
    size = ("--splats", "50", "--width", "40", "--height", "30", "--steps", "3")
    code, out, err = gscore("bench", "step", "--device", str(tested.number), *size, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["isa"].startswith("gpu: ") and found["queued_ms"] > 0 and found["step_ms"] > 0
    _, out, _ = gscore("bench", "step", "--device", str(tested.number), *size)
    assert "ms with others in flight, as in trainings" in out


def test_benches_of_trainings_name_their_device(gscore, tested: Device, tmp_path: Path) -> None:
    """Oracle: device and driver in results.json; the CPU's results are not continued."""
    capture = Path(__file__).parents[2] / "examples" / "studio"
    options = ("-r", "60", "--iterations", "3", "--seeds", "0", "--preset", "preview")
    for verb, rest in (
        ("quality", (*options, "--offsets", "0")),
        ("time-error", (*options[:-2], "--presets", "preview", "--mask-mode", "none")),
    ):
        out = ("-o", tmp_path / verb, "--json")
        device = ("--device", str(tested.number))
        code, text, err = gscore("bench", verb, capture, *rest, *out, *device)
        assert code == 0, err
        found = json.loads(text)
        assert found["device"] == tested.name and found["isa"].startswith(f"gpu: {tested.name}")
        if verb == "quality":
            assert found["trainings"][0]["splats"] > 0
            code, _, err = gscore("bench", verb, capture, *rest, *out)
            assert code == 2 and "isa was gpu: " in " ".join(err.split())


@pytest.mark.parametrize("verb", [("stress",), ("bench", "raster")])
def test_an_instruction_set_is_of_the_cpu(gscore, verb) -> None:
    """Oracle: exit code 2 and both options."""
    code, _, err = gscore(*verb, "--device", "gpu", "--isa", "scalar")
    assert code == 2 and "--isa" in err and "--device" in err
