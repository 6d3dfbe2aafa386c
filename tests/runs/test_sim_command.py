"""``bench sim`` as a process of its own: what it serves, to whom, how it ends and begins again, its runs and faults."""

import json
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from rehearsal import Inside, bench
from served_bench import CLOCK, SEED, Served, powered_rack

from bench.commands.sim import sim
from bench.frame import LinkDecoder, load_frame
from bench.model.errors import InputError, InputErrors
from bench.model.lab import find_shipped
from bench.plan import load_station
from sim_instruments.served.process import ServedBench
from sim_instruments.worlds.simulation import possible_faults

pytestmark = pytest.mark.waits


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = powered_rack(tmp_path_factory.mktemp("bench") / "sim")
    yield served
    print(f"the simulated bench used {served.cpu_s():.1f} s of CPU")
    assert served.end() == 0


@pytest.fixture
def served(process: Served) -> Iterator[Served]:
    yield process
    process.fault("clear")


def test_it_says_what_it_serves_and_the_station_can_be_loaded(served: Served, inside: Inside) -> None:
    roles = list(load_station(find_shipped("stations", "af_rack_sim")).instruments)
    assert len(roles) == 14
    assert [line.split(":")[0] for line in served.said] == [*roles, "GPIB0", "port_a", "port_b", "station", "ready"]
    station = served.station
    assert (station.simulated, station.in_process, station.file.visa) == (True, False, "@py")
    assert list(station.instruments) == roles
    assert oct((served.folder / "control.sock").stat().st_mode)[-3:] == "600"
    checked = inside("check", "scale_factor_wall", "--station", str(served.folder / "station.yaml"))
    assert checked.returncode == 0, checked.stderr


def test_fourteen_instruments_answer_each_with_its_own_serial_number(served: Served) -> None:
    questions = {"dmm": "ID?", "chamber": "IDEN?"}
    identities = {role: served[role].query(questions.get(role, "*IDN?")) for role in served.station.instruments}
    assert all(identities.values())
    for role in ("function_generator_2", "counter_2", "counter", "calibrator"):
        standard = served.station.instruments[role].standard
        assert identities[role].split(",")[2] == standard.serial


def test_the_links_run_in_real_time_and_lose_nothing(served: Served) -> None:
    heard = served.listen("port_a", 3.0)
    assert (heard.bad, heard.lost) == (0, 0)
    assert heard.frames > 200
    lost = served.state()["link_bytes"]["port_a"]["lost"]  # nobody listens: these bytes do not come later
    served.until(lambda state: state["link_bytes"]["port_a"]["lost"] > lost, "bytes that nobody hears")
    assert served.listen("port_a", 0.5).lost == 0


def test_a_listener_who_never_reads_blocks_nothing(served: Served) -> None:
    with serial.Serial(str(served.folder / "port_a"), timeout=0):
        CLOCK.sleep(2.0)
        assert served.listen("port_b", 0.5).frames > 0
        assert served["calibrator"].query("*IDN?").startswith("FLUKE")
    with serial.Serial(str(served.folder / "port_a"), timeout=0) as again:
        again.reset_input_buffer()
        CLOCK.sleep(0.1)
        assert 0 < again.in_waiting < 4096


def test_commands_reach_the_unit(served: Served) -> None:
    definition = load_frame(find_shipped("frames", "ngu_b"))
    decoder = LinkDecoder(definition)
    with serial.Serial(str(served.folder / "port_b"), timeout=0.05) as port:
        port.write(definition.encode_one({"command": 1, "payload": []}, "command"))
        for _ in range(20):
            decoder.push(CLOCK.now_ns(), port.read(10_000))
    answers = decoder.flush().messages["answer"]
    assert bytes(answers.raw("payload")[0]).startswith(b"NGU SIM-1")


def test_the_command_says_what_is_on_and_prints_the_state(served: Served, inside: Inside) -> None:
    words = ("--dir", str(served.folder))
    assert bench("sim", "fault", "late", "supply", "2", "3", *words).stdout == "on: late supply 2 3\n"
    assert json.loads(inside("sim", "fault", "state", *words).stdout)["faults"] == ["late supply 2 3"]
    assert inside("sim", "fault", "clear", *words).stdout == "no fault is on\n"


@pytest.mark.parametrize(
    ("words", "rate", "settings", "code"),
    [
        (("fault", "mutt", "dmm"), 1, (), "B-SIM-010"),
        (("fault", "mute", "dmmm"), 1, (), "B-SIM-011"),
        (("fault", "drop", "port_a", "2"), 1, (), "B-SIM-012"),
        (("af_rack_sim",), 1, (), "B-SIM-013"),
        (("af_rack_sim", "twice"), 1, (), "B-SIM-017"),
        (("af_rack_sim",), 0, (), "B-SIM-017"),
        (("af_rack_sim",), 1, ("settle=1 s",), "B-SIM-017"),
        (("af_rack_sim",), 1, ("world.nois=off",), "B-PLAN-004"),
        (("af_rack_sim",), 1, ("world.time_constants=0.5",), "B-SIM-002"),
    ],
)
def test_mistakes_are_one_clear_error(
    served: Served, words: tuple[str, ...], rate: float, settings: tuple[str, ...], code: str, tmp_path: Path
) -> None:
    folder = tmp_path if code == "B-SIM-002" else served.folder
    with pytest.raises(InputError) as caught:
        sim(words, folder, rate, SEED, settings)
    error = caught.value.errors[0] if isinstance(caught.value, InputErrors) else caught.value
    assert (error.code, error.exit_status) == (code, 2)
    assert not (tmp_path / "port_a").is_symlink()


def test_a_served_station_is_served_once_and_in_real_time(served: Served, tmp_path: Path, inside: Inside) -> None:
    station = str(served.folder / "station.yaml")
    with pytest.raises(InputError, match="B-SIM-016"):
        sim([station], tmp_path, 1.0, SEED, [])
    words = ("run", "scale_factor_wall_30s", "--station", station, "--clock", "virtual", "--out", str(tmp_path))
    done = inside(*words)
    assert (done.returncode, "B-RUN-001" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("fault", "trip"), "B-SIM-015"),
        (("fault", "chamber_runaway", "-2"), "B-SIM-015"),  # it was a value: the bench was asked
        (("af_bench_sim", "--ratee", "2"), "B-SIM-017: '--ratee' is no option"),
    ],
)
def test_nobody_there_and_an_option_that_is_none(
    words: tuple[str, ...], code: str, tmp_path: Path, inside: Inside
) -> None:
    done = inside("sim", *words, "--dir", str(tmp_path))
    assert (done.returncode, done.stdout, code in done.stderr) == (2, "", True)


def test_no_room_for_a_socket(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / ("long" * 40), tmp_path / "file"):
        with pytest.raises(InputError, match="B-SIM-014"):
            sim(["af_bench_sim"], folder, 1.0, SEED, [])


def is_gone(port: serial.Serial) -> bool:
    try:
        for _ in range(3):  # what had arrived comes first
            port.read(10_000)
    except serial.SerialException:
        return True
    return False


def test_faults_reach_terminals_and_sessions(served: Served) -> None:
    """What each of the faults does is in tests/unit/sim_instruments/faults; here is the way of one of each kind."""
    assert served.fault("drop", "port_a", "0.2") == ["drop port_a 0.2"]
    assert served.listen("port_a", 1.0).lost > 3
    served.fault("late", "supply", "0.6")
    began_ns = CLOCK.now_ns()
    assert served["supply"].query("VOLT?") == "1.80000E+01"
    assert CLOCK.now_ns() - began_ns >= 600_000_000


def test_unplugged_and_back(served: Served) -> None:
    path = served.folder / "port_a"
    with serial.Serial(str(path), timeout=1.0) as port:
        served.fault("unplug", "port_a")
        assert is_gone(port)
        assert not path.is_symlink()
    assert served.fault("replug", "port_a") == []
    CLOCK.sleep(0.1)
    assert served.listen("port_a", 0.5).frames > 10


def test_every_fault_is_in_the_list_and_has_a_test(served: Served, inside: Inside) -> None:
    faults = possible_faults()
    listed = inside("sim", "fault", "--dir", str(served.folder)).stdout.splitlines()
    assert [line.split()[0] for line in listed] == [*faults, "clear", "state"]
    unit = Path(__file__).parents[1] / "unit/sim_instruments"
    text = "".join((unit / name).read_text() for name in ("faults/test_fault_switches.py", "test_sim_table.py"))
    assert {name for name in faults if f'"{name}"' not in text} == set()


# --- at the end: a bench that ends closes the VISA sessions of this process ------------------------------------------


def test_it_ends_clean_and_takes_over_from_one_that_was_killed(tmp_path: Path) -> None:
    folder = tmp_path / "sim"
    first = Served(folder, "af_bench_sim", "--rate", "10")
    assert first.end(signal.SIGKILL) == -signal.SIGKILL
    assert (folder / "port_a").is_symlink()
    again = Served(folder, "af_bench_sim", "--rate", "10", "--set", "world.noise=off")
    assert again.said == first.said, "raw sockets and terminals too, and nothing is told"
    again.send("supply", "VOLT 18", "CURR 2", "OUTP ON")
    again.until(lambda state: sum(state["link_bytes"]["port_a"].values()) > 0, "the first frame of the unit")
    heard = again.listen("port_a", 1.0)
    assert heard.frames > 500  # ten times as fast
    assert again.end(signal.SIGINT) == 0
    assert sorted(path.name for path in folder.iterdir()) == ["ports.json", "sim.lock", "station.yaml"]


def test_a_port_that_somebody_else_has_is_told_and_another_one_taken(tmp_path: Path) -> None:
    folder = tmp_path / "sim"
    first = Served(folder, "af_bench_sim")
    for number in (signal.SIGSTOP, signal.SIGCONT):  # it stands still for a while, and goes on
        first.process.send_signal(number)
        CLOCK.sleep(1.0)
    assert "supply" in first.state()["instruments"]
    assert first.end() == 0
    ports = json.loads((folder / "ports.json").read_text())
    with socket.create_server(("127.0.0.1", ports["supply"])):
        again = Served(folder, "af_bench_sim")
        now = json.loads((folder / "ports.json").read_text())
        assert again.end() == 0
    assert {name for name, port in ports.items() if now[name] != port} == {"supply"}
    (told,) = (line for line in again.said if "is taken" in line)
    assert told.startswith(f"supply: port {ports['supply']} is taken, another one is used")


@pytest.mark.parametrize("text", ["", "[1]", '{"hislip": "x"}', '{"hislip": 70000}', '{"hislip": -1}', "\xff"])
def test_ports_that_cannot_be_read_are_forgotten(tmp_path: Path, text: str) -> None:
    (tmp_path / "ports.json").write_text(text, encoding="latin-1")
    served = ServedBench(
        "af_converter", load_station(find_shipped("stations", "af_bench_sim")).wiring(), {}, seed=1, rate=1.0,
        folder=tmp_path,
    )  # fmt: skip
    try:
        assert json.loads((tmp_path / "ports.json").read_text())["hislip"] > 0
    finally:
        served.close()
