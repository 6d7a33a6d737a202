"""What `estimate` refuses: arrays, files, places and options that cannot be used."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ahrs_service.app.cli import main

ROWS = np.zeros((5, 3))
GOOD = {"imu_gyr": ROWS, "imu_acc": ROWS, "sampling_rate": 100.0}


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"imu_acc": ROWS, "sampling_rate": 100.0}, ["imu_gyr", "missing", "rad/s"]),
        ({"imu_gyr": ROWS, "sampling_rate": 100.0}, ["imu_acc", "missing", "m/s^2"]),
        ({"imu_gyr": ROWS, "imu_acc": ROWS}, ["sampling_rate", "t [N]"]),
        (GOOD | {"imu_gyr": ROWS.T}, ["imu_gyr", "(3, 5)", "[N, 3]"]),
        (GOOD | {"imu_acc": ROWS[:4]}, ["imu_acc", "(4, 3)", "N = 5"]),
        (GOOD | {"imu_mag": ROWS[:, :2]}, ["imu_mag", "(5, 2)", "uT"]),
        (GOOD | {"airspeed": ROWS}, ["airspeed", "(5, 3)", "[N]"]),
        (GOOD | {"vel_ned": ROWS[:1]}, ["vel_ned", "(1, 3)"]),
        (GOOD | {"imu_gyr": np.full((5, 3), "a")}, ["imu_gyr", "real numbers"]),
        (GOOD | {"imu_gyr": ROWS.astype(complex)}, ["imu_gyr", "complex128"]),
        (GOOD | {"imu_gyr": np.array(1.0)}, ["imu_gyr", "()"]),
        (GOOD | {"imu_gyr": ROWS[:0], "imu_acc": ROWS[:0]}, ["no sample"]),
        (GOOD | {"sampling_rate": 0.0}, ["sampling_rate = 0.0", "above 0"]),
        (GOOD | {"sampling_rate": np.nan}, ["sampling_rate = nan"]),
        (GOOD | {"sampling_rate": [1.0, 2.0]}, ["sampling_rate", "one number"]),
        (GOOD | {"t": np.full(5, np.nan)}, ["t holds no finite time"]),
        (GOOD | {"t": np.arange(5) * 1e12}, ["t spans", "seconds"]),
        (GOOD | {"t": np.arange(5) * 20.0}, ["t rises by 20 a sample", "seconds"]),
        (GOOD | {"t": np.ones(5)}, ["t never rises", "sampling_rate"]),
        (GOOD | {"imu_gyr": np.array([None] * 5)}, ["not a complete .npz"]),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, capsys, fields, said):
    source = tmp_path / "in.npz"
    np.savez(source, **fields)
    assert main(["estimate", "--in", str(source), "--out", str(tmp_path / "out.npz")]) == 1
    message = capsys.readouterr().err
    assert "error:" in message
    for words in [str(source), *said]:
        assert words in message
    assert not (tmp_path / "out.npz").exists()


def test_other_files_and_places_are_refused(tmp_path, capsys):
    source, single = tmp_path / "in.npz", tmp_path / "single.npy"
    np.savez(source, **GOOD)
    np.save(single, ROWS)
    cases = [
        (tmp_path / "none.npz", tmp_path / "out.npz", "No such file"),
        (tmp_path, tmp_path / "out.npz", "directory"),
        (single, tmp_path / "out.npz", "array without a name"),
        (source, tmp_path / "no" / "out.npz", "cannot be written"),
        (source, source, "input file"),
    ]
    for place, out, said in cases:
        assert main(["estimate", "--in", str(place), "--out", str(out)]) == 1
        assert said in capsys.readouterr().err
    with np.load(source) as file:
        assert set(file.files) == set(GOOD)


@given(st.data())
def test_a_damaged_file_is_refused_or_read(tmp_path_factory, data):
    source = tmp_path_factory.mktemp("damaged") / "in.npz"
    np.savez_compressed(source, **GOOD)
    content = bytearray(source.read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=4)):
        content[place] ^= data.draw(st.integers(1, 255))
    source.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    assert main(["estimate", "--in", str(source), "--out", str(source.with_name("o"))]) in (0, 1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--set", "fusion.mode=best"], "fusion.mode"),
        (["--set", "fusion"], "section.key=value"),
        (["--config", "none.toml"], "none.toml"),
    ],
)
def test_wrong_settings_are_wrong_usage(tmp_path, capsys, options, said):
    source = tmp_path / "in.npz"
    np.savez(source, **GOOD)
    words = ["estimate", "--in", str(source), "--out", str(tmp_path / "out.npz")]
    assert main([*words, *options]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("options", [["--frame", "ned"], ["--smooth"]])
def test_unknown_options_are_wrong_usage(tmp_path, capsys, options):
    with pytest.raises(SystemExit) as exit_:
        main(["estimate", "--in", "a.npz", "--out", str(tmp_path / "o.npz"), *options])
    assert exit_.value.code == 2
