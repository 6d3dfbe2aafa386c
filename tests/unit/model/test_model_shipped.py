"""Shipped files: path first, then name, and nothing outside the shipped folder by name."""

from pathlib import Path

import pytest

from bench.model import shipped
from bench.model.errors import ExitStatus, InputError
from bench.model.shipped import find_shipped, shipped_folder, shipped_names

TOP = Path(__file__).resolve().parents[3]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package folder in a site-packages with one frame inside, and a current folder that is empty."""
    inside = tmp_path / "site" / "bench" / "shipped" / "frames"
    inside.mkdir(parents=True)
    (inside / "ngu_a.yaml").write_text("frame: ngu_a\n")
    monkeypatch.setattr(shipped, "_PACKAGE", tmp_path / "site" / "bench")
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    return inside


def test_checkout_serves_its_own_folders() -> None:
    assert shipped_folder("frames") == TOP / "frames"


def test_installed_folder_goes_before_a_neighbour_of_the_package(package: Path) -> None:
    (package.parents[2] / "frames").mkdir()
    assert shipped_folder("frames") == package
    assert shipped_names("frames") == ["ngu_a"]


@pytest.mark.parametrize("name", ["ngu_a", "ngu_a.yaml"])
def test_by_name(package: Path, name: str) -> None:
    assert find_shipped("frames", name) == package / "ngu_a.yaml"


def test_path_goes_before_name(package: Path) -> None:
    Path("ngu_a.yaml").write_text("frame: mine\n")
    assert find_shipped("frames", "ngu_a.yaml").read_text() == "frame: mine\n"
    assert find_shipped("frames", "ngu_a") == package / "ngu_a.yaml"


@pytest.mark.parametrize("name", ["ngu_b", "../frames/ngu_a", "/ngu_a", "", ".", "ngu\0a", "x" * 5000], ids=range(7))
def test_nothing_of_that_name(package: Path, name: str) -> None:
    with pytest.raises(InputError) as caught:
        find_shipped("frames", name)
    assert caught.value.code == "B-SHIP-001"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert "ngu_a" in caught.value.next_step


def test_near_name_is_proposed(package: Path) -> None:
    with pytest.raises(InputError, match=r"B-SHIP-001.*did you mean 'ngu_a'"):
        find_shipped("frames", "ngu_aa")


@pytest.mark.parametrize(
    ("kind", "name", "what", "taken"),
    [
        ("sequences", "vn100_binary", "this is a frame, and a sequence is due", "bench decode vn100_binary FILE"),
        ("sequences", "vn100_binary.yaml", "this is a frame, and a sequence is due", "bench decode vn100_binary FILE"),
        ("sequences", str(TOP / "frames" / "ngu_a.yaml"), "this is a frame", "frames/ngu_a.yaml FILE"),
        ("sequences", "af_bench_sim", "this is a station, and a sequence is due", "--station af_bench_sim of"),
        ("sequences", str(TOP / "docs" / "mappings" / "tckit_1v_ramp.yaml"), "this is a mapping", "bench import"),
        ("frames", "timeline_example", "this is a sequence, and a frame is due", "bench run timeline_example"),
        ("stations", "ngu_a", "this is a frame, and a station is due", "a sequence names it under 'frame'"),
        ("stations", str(TOP / "sequences" / "gnc_bias.yaml"), "this is a sequence", "bench check"),
    ],
)
def test_a_file_of_another_kind_is_named_with_who_takes_it(
    kind: shipped.Kind, name: str, what: str, taken: str
) -> None:
    with pytest.raises(InputError, match=what) as caught:
        find_shipped(kind, name)
    assert (caught.value.code, caught.value.exit_status) == ("B-SHIP-002", ExitStatus.BAD_INPUT)
    assert taken in caught.value.next_step


def test_every_shipped_file_is_of_its_kind() -> None:
    for kind in shipped.KINDS:
        for name in shipped_names(kind):
            assert find_shipped(kind, shipped_folder(kind) / f"{name}.yaml").stem == name
