"""Choice by `--device`, and the CPU where a card fails."""

import numpy as np
import pytest

import gscore
from gscore.errors import BackendError, ConfigError
from gscore.raster import native_library
from gscore.raster.gpu import absence, choice
from gscore.raster.gpu.absence import may_have_card
from gscore.raster.gpu.choice import choose
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.library import DeviceLostError, DeviceMemoryError, DeviceTimeoutError
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from tests.gpu.fake_gpu import SOFTWARE, card

INTEGRATED = {"kind": 1, "name": b"Small", "uuid": bytes(16)}


@pytest.fixture
def machine(fake):
    """A machine with cards whose self-tests are done; by number those that failed."""

    def install(*cards, failed=()):
        made = fake(*cards)
        for device in find_devices().devices:
            problems = ("wrong pictures",) if device.number in failed else ()
            keep_verdict(device.key, DeviceVerdict(passed=not problems, problems=problems))
        return made

    return install


def _number(device: str):
    found = choose(device).device
    return None if found is None else found.number


def test_the_cpu_needs_no_library() -> None:
    """Oracle: a list of devices that must not be made."""
    assert choose("cpu", find=lambda: pytest.fail("listed")).device is None


def test_the_best_card_is_chosen(machine) -> None:
    """Oracle: discrete before integrated before software, whatever their order."""
    machine(card(**SOFTWARE), card(**INTEGRATED), card())
    assert [_number(device) for device in ("gpu", "auto", "0", "1", "2")] == [2, 2, 0, 1, 2]
    assert choose("auto").note == "" and choose("auto").fallback and not choose("gpu").fallback


def test_ranks_take_the_best_cards_in_turn(machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the discrete cards by the local number, the integrated one and the CPU never; the
    next card where the own one failed."""
    other = card(name=b"Other", uuid=bytes([9] * 16))
    machine(card(**INTEGRATED), card(), other)
    for rank, number in (("0", 1), ("1", 2), ("2", 1), ("x", 1)):
        monkeypatch.setenv("LOCAL_RANK", rank)
        assert _number("gpu") == _number("auto") == number
        assert _number("0") == 0
    machine(card(**INTEGRATED), card(), other, failed=[2])
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert _number("gpu") == 1


def test_a_card_that_failed_is_passed_over(machine) -> None:
    """Oracle: the next kind of card, and the reason in the note."""
    machine(card(**INTEGRATED), card(), failed=[1])
    for device in ("gpu", "auto"):
        found = choose(device)
        assert found.device is not None and found.device.number == 0
        assert found.note.startswith("Small is used. Device 1 (Card): Its self-test failed: wrong")
    with pytest.raises(BackendError, match=r"Device 1 \(Card\) is not used. Its self-test failed"):
        choose("1")


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_auto_is_the_cpu_on_untested_platforms(
    machine, monkeypatch: pytest.MonkeyPatch, platform: str
) -> None:
    """Oracle: no list of devices for `auto`, and a reason that is not shown; cards can still be
    named."""
    machine(card())
    assert _number("gpu") == _number("0") == 0
    monkeypatch.setattr(absence, "_AUTO_ON", ("linux",))
    monkeypatch.setattr(absence.sys, "platform", platform)
    found = choose("auto", find=lambda: pytest.fail("listed"))
    assert found.device is None and not found.note
    assert "no graphics card is chosen automatically" in found.reason


def test_auto_without_a_driver_s_device_file_loads_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    """Oracle: a list of devices that must not be made; device files of three kinds of drivers."""
    monkeypatch.setattr(absence, "may_have_card", lambda: may_have_card(tmp_path))
    found = choose("auto", find=lambda: pytest.fail("listed"))
    assert found.device is None and not found.note and found.reason == "There is no graphics card."
    for name in ("nvidiactl", "dxg", "dri/renderD128"):
        root = tmp_path / name.replace("/", "-")
        path = root / "dev" / name
        path.parent.mkdir(parents=True)
        assert not may_have_card(root)
        path.touch()
        assert may_have_card(root)


def test_software_is_chosen_by_name_only(machine) -> None:
    """Oracle: `auto` draws on the CPU, which is not mentioned, `gpu` takes it with a warning."""
    machine(card(**SOFTWARE))
    auto, gpu = choose("auto"), choose("gpu")
    assert auto.device is None and not auto.note
    assert "llvmpipe, is a software device" in auto.reason
    assert gpu.device is not None and "more slowly than with `--device cpu`" in gpu.note
    assert choose("0").note == gpu.note


def test_without_devices_there_is_a_reason(fake) -> None:
    """Oracle: the library's message as the reason for `auto`, in errors otherwise."""
    fake(message="there is no Vulkan loader on this system")
    auto = choose("auto")
    assert auto.device is None and not auto.note and auto.reason.startswith("There is")
    with pytest.raises(BackendError, match="No graphics card can be used"):
        choose("gpu")
    with pytest.raises(ConfigError, match="There is no device 0"):
        choose("0")


def test_numbers_that_are_not_listed_are_named(machine) -> None:
    """Oracle: the number, and those that are listed."""
    machine(card(), card(**SOFTWARE))
    with pytest.raises(ConfigError, match=r"no device 2; `gscore doctor` lists devices 0 to 1"):
        choose("2")


def test_uuids_name_devices(machine) -> None:
    """Oracle: their numbers, also for a UUID of digits alone; a sentence for one that is gone."""
    machine(card(**SOFTWARE), card(**INTEGRATED))
    assert _number(bytes(range(16)).hex()) == 0 and _number("0" * 32) == 1
    gone = "The chosen graphics card is not in this computer any more; `gscore doctor` lists dev"
    with pytest.raises(ConfigError, match=gone):
        choose("f" * 32)


@pytest.mark.parametrize("text", ["", "f" * 31, "F" * 32, "GPU", "-1", "cuda:0", "1.0", "\u0662"])
def test_other_words_are_refused(text: str) -> None:
    """Oracle: the choices in the sentence."""
    with pytest.raises(ConfigError, match="must be cpu, gpu, auto or a number"):
        choose(text)


def test_a_card_without_features_is_not_tested(fake) -> None:
    """Oracle: the missing feature; no self-test was started."""
    fake(card(missing=b"buffer addresses"))
    with pytest.raises(BackendError, match="lacks buffer addresses"):
        choose("gpu")
    assert "lacks buffer addresses" in choose("auto").note


def _splats() -> gscore.Splats:
    f = lambda *shape: np.ones(shape, np.float32)  # noqa: E731
    return gscore.Splats(
        means=f(2, 3), quats=f(2, 4), scales=f(2, 3), opacities=f(2), sh0=f(2, 1, 3), shN=f(2, 3, 3)
    )


def _render(splats: gscore.Splats, **options) -> gscore.Rendered:
    return gscore.render(splats, np.diag([9.0, 9.0, 1.0]), np.eye(4), 8, 6, **options)


def test_splats_are_copied_once_if_kept(machine) -> None:
    """Oracle: the calls of the library; unkept splats may change, so that each picture copies
    them."""
    library, splats = machine(card()), _splats()
    for _ in range(3):
        assert _render(splats, device="gpu", keep=True).visible == 3
    assert library.calls == ["open", "upload", "draw", "draw", "draw"]
    library.calls.clear()
    for _ in range(2):
        _render(_splats(), device="0")
    assert library.calls == ["upload", "draw", "release", "upload", "draw"]


@pytest.mark.parametrize(
    ("status", "kind", "words"),
    [
        (7, DeviceLostError, "Update the graphics driver"),
        (8, DeviceTimeoutError, "GSCORE_GPU_SECONDS"),
        (2, DeviceMemoryError, "Close programs"),
    ],
)
def test_errors_of_a_card_name_the_remedy(machine, status: int, kind: type, words: str) -> None:
    """Oracle: the class, the library's message and the remedy."""
    library = machine(card())
    library.statuses["draw"], library.message = [status], "the draw failed"
    with pytest.raises(kind, match=f"^The draw failed. .*{words}"):
        _render(_splats(), device="gpu")
    assert _render(_splats(), device="gpu").visible == 3
    assert library.calls.count("open") == (1 if kind is DeviceMemoryError else 2)


def test_auto_goes_on_with_the_cpu(machine, caplog: pytest.LogCaptureFixture) -> None:
    """Oracle: the CPU's picture, and one sentence for all pictures."""
    library, splats = machine(card()), _splats()
    library.statuses["draw"], library.message = [7], "lost"
    pictures = [_render(splats, device="auto").rgb for _ in range(3)]
    assert all(np.array_equal(picture, _render(splats).rgb) for picture in pictures)
    assert library.calls.count("draw") == 1
    assert choice.chosen_device("auto").name == "Card, then cpu"
    (record,) = caplog.records
    assert record.getMessage().startswith("The CPU draws from here on, because Card failed: Lost.")


def test_kept_splats_make_room(machine) -> None:
    """Oracle: an upload that succeeds after the kept splats were freed."""
    library, first, second = machine(card()), _splats(), _splats()
    _render(first, device="gpu", keep=True)
    library.statuses["upload"] = [2]
    _render(second, device="gpu", keep=True)
    assert library.calls == ["open", "upload", "draw", "upload", "release", "upload", "draw"]


def test_kept_splats_make_room_for_a_picture(machine) -> None:
    """Oracle: a draw that succeeds after the other kept splats were freed; without any the error of
    the first draw."""
    library, first, second = machine(card()), _splats(), _splats()
    _render(first, device="gpu", keep=True)
    library.calls.clear()
    library.statuses["draw"] = [2]
    assert _render(second, device="gpu", keep=True).visible == 3
    assert library.calls == ["upload", "draw", "release", "draw"]
    library.statuses["draw"] = [2]
    with pytest.raises(DeviceMemoryError):
        _render(second, device="gpu", keep=True)


def test_the_identity_has_library_and_failures(
    machine, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    """Oracle: SHA-256 of the library's file, and the CPU's instruction set after a failure."""
    machine(card()).statuses["draw"] = [7]
    (tmp_path / "lib").write_bytes(b"abc")
    monkeypatch.setenv("GSCORE_GPU_LIBRARY", str(tmp_path / "lib"))
    keep_verdict(find_devices().devices[0].key, DeviceVerdict(passed=True))
    chosen, cpu = choose("auto"), choice.CPU.identity
    assert chosen.identity == "gpu: Card, driver 1.0, library ba7816bf" and chosen.name == "Card"
    _render(_splats(), device=chosen)
    assert chosen.identity == f"gpu: Card, driver 1.0, library ba7816bf, then {cpu}"
    assert cpu == native_library.isa()


def test_a_self_test_is_logged(fake, monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    """Oracle: one sentence for each device, before its result."""
    fake(card(), card(name=b"Other", uuid=bytes(16), kind=1))

    def failing(device, *, report, **_: object) -> DeviceVerdict:
        for end in ("", ": starting", ": drawing"):
            report(f"Testing {device.name} once, at most 60 s{end}")
        return DeviceVerdict(passed=device.name == "Other", problems=("black",))

    monkeypatch.setattr(choice, "verified", failing)
    _render(_splats(), device="gpu")
    texts = [record.getMessage() for record in caplog.records]
    assert texts[:2] == [f"Testing {name} once, at most 60 s." for name in ("Card", "Other")]
    assert len(texts) == 3 and texts[2].startswith("Other is used.")


def test_a_choice_by_name_is_made_once(machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the number of lists of devices."""
    machine(card())
    lists = []
    monkeypatch.setattr(choice, "choose", lambda name, **_: lists.append(name) or choose(name))
    for _ in range(3):
        _render(_splats(), device="auto")
    assert lists == ["auto"]
