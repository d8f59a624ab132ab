"""Calibrations from files: clicked control points and images in, boresight out; and the ways the files can be wrong."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from benchmarks.boresight_flights import MOUNTING, Conditions, fly
from benchmarks.calibration_data import CLICKS, GEOREFERENCE, IMAGES, write
from estimators.aerial.boresight_observations import BoresightObservations
from estimators.aerial.boresight_result import BoresightResult
from reports.calibrations.run import load_calibration
from reports.calibrations.time_offset import ALL, least, time_offset_table
from sim.streams import stream
from tests.scenarios.conftest import Command, Result

Array = np.ndarray
TRUTH_DEG = np.rad2deg(MOUNTING.boresight)
ADJUSTED = "one adjustment"
MOTION = 6  # columns of velocity and rate at the end of the list of images


@dataclass(frozen=True)
class Files:
    """A calibration flight on disk without errors of clicks and navigation."""

    folder: Path

    @property
    def clicks(self) -> Path:
        return self.folder / CLICKS

    @property
    def images(self) -> Path:
        return self.folder / IMAGES

    @property
    def settings(self) -> list[str]:
        return [f"calibration.gcp_list={self.clicks}", f"calibration.images={self.images}"]

    def rows(self) -> list[dict[str, str]]:
        with self.images.open(encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def write_rows(self, rows: list[dict[str, str]]) -> None:
        lines = [",".join(rows[0]), *(",".join(row.values()) for row in rows)]
        self.images.write_text("\n".join(lines) + "\n")

    def change(self, image: int, **values: str) -> None:
        rows = self.rows()
        rows[image] |= values
        self.write_rows(rows)

    def without_motion(self) -> None:
        self.write_rows([dict(list(row.items())[:-MOTION]) for row in self.rows()])

    def lines(self) -> list[str]:
        return self.clicks.read_text().splitlines()

    def write_lines(self, lines: list[str]) -> None:
        self.clicks.write_text("\n".join(lines) + "\n")


@pytest.fixture
def files(tmp_path: Path) -> Files:
    folder = tmp_path / "measured"
    folder.mkdir()
    write(fly(Conditions(is_exact=True), stream(3, 0, "test")), folder)
    return Files(folder)


def run(command: Command, files: Files, *more: str, out: str = "out", stage: str = "report") -> Result:
    settings = [part for s in (*files.settings, *more) for part in ("--set", s)]
    return command("run", "boresight-gcps", *settings, "--out", out, "--stage", stage)


def estimated(command: Command, files: Files, *more: str, out: str = "out") -> Array:
    """Boresight angles [deg] of the adjustment; without a report."""
    result = run(command, files, *more, out=out, stage="estimate")
    assert result.status == 0, result.err
    return angles(out)


def found(out: str = "out", label: str = ADJUSTED) -> BoresightResult:
    return BoresightResult.load(Path(out) / "estimates" / label)


def angles(out: str = "out", label: str = ADJUSTED) -> Array:
    return np.rad2deg(found(out, label).x[:3])


def left_out(label: str) -> dict[str, str]:
    table = pd.read_csv("out/excluded.csv", keep_default_na=False)
    own = table[table["estimator"] == label]
    return dict(zip(own["what"], own["reason"], strict=True))


def test_the_flight_that_ships(command: Command) -> None:
    """Vibration and GNSS as explain the source's residuals; three wrong clicks, one outside its image."""
    result = command("run", "boresight-gcps", "--out", "out")
    assert result.status == 0, result.err
    assert "lies outside 1024x1024" in result.out
    assert "boresight kappa estimate" in result.out
    metrics = pd.read_csv("out/metrics.csv", keep_default_na=False)
    own = metrics[(metrics["estimator"] == ADJUSTED) & (metrics["entity"] == "")].set_index(
        ["quantity", "axis", "statistic"]
    )
    assert chi2.cdf(3 * own.loc[("boresight", "all", "nees"), "value"], 3) < 0.999
    assert 4.0 < own.loc[("residual", "all", "rms"), "value"] < 6.5
    scatter = metrics[(metrics["quantity"] == "boresight") & (metrics["statistic"] == "std")]["value"]
    assert scatter.between(0.05, 0.12).all()
    assert len(left_out(ADJUSTED)) == 3
    assert all("taken for a wrong click" in reason for reason in left_out(ADJUSTED).values())
    assert left_out("") == {"P16 in antar_05.jpg": "(2041.0, 666.5) px lies outside 1024x1024"}
    residuals = pd.read_csv("out/residuals.csv")
    assert residuals.groupby("estimator").size().eq(95).all()
    wrong = residuals[(residuals["estimator"] == ADJUSTED) & residuals["rejected"]]
    assert np.hypot(wrong["du_adjusted_px"], wrong["dv_adjusted_px"]).min() > 15
    page = Path("out/report.html").read_text()
    assert all(f'alt="{name}"' in page for name in ("angles", "residuals", "time_offset"))
    assert "http" not in page.replace("http-equiv", "")


def test_without_errors_the_truth_comes_out(command: Command, files: Files) -> None:
    estimated(command, files)
    for label in ("image by image", ADJUSTED):  # angles are written to 1e-4 degrees, pixels to 1e-4
        assert np.abs(angles(label=label) - TRUTH_DEG).max() < 1e-4
        assert found(label=label).rms_px < 0.02  # 1e-4 degrees are 0.004 px
    assert not BoresightObservations.load(Path("out/observations")).excluded


def test_headings_against_grid_north_differ_by_the_convergence(command: Command, files: Files) -> None:
    true = estimated(command, files, out="true")
    mistaken = estimated(command, files, "calibration.heading='grid'", out="mistaken")
    convergence = float(np.rad2deg(GEOREFERENCE.convergence(np.zeros(3))))
    assert convergence > 1.9
    # Tilts of body and camera, 3.5 degrees at most, turn the vertical out of kappa's axis: 1 - cos = 0.002.
    assert true[2] - mistaken[2] == pytest.approx(convergence, rel=0.002)
    for i, row in enumerate(files.rows()):
        files.change(i, heading_deg=f"{(float(row['heading_deg']) - convergence) % 360:.4f}")
    grid = estimated(command, files, "calibration.heading='grid'", out="grid")
    assert np.abs(grid - TRUTH_DEG).max() < 3e-4  # over 20 m the convergence changes by 2e-4 degrees


def test_heights_over_the_geoid(command: Command, files: Files) -> None:
    lines = files.lines()
    lowered = [line.split() for line in lines[1:]]
    files.write_lines([lines[0], *(" ".join([*f[:2], f"{float(f[2]) - 46:.4f}", *f[3:]]) for f in lowered)])
    assert np.abs(estimated(command, files, "calibration.undulation_m=46") - TRUTH_DEG).max() < 1e-4


def test_records_of_a_simulated_flight(command: Command, files: Files) -> None:
    """JSON as `dataclasses.asdict(ImageRecord)` writes it: two heads, numbers as numbers, no velocities."""
    numbers = [{k: v if k == "file" else float(v) for k, v in row.items()} for row in files.rows()]
    records = [
        dict(list(row.items())[:-MOTION]) | {"head": head, "file": name, "width_px": 1024, "height_px": 1024}
        for row in numbers
        for head, name in (("left", row["file"]), ("nadir", f"nadir-{row['file']}"))
    ]
    path = files.folder / "images.json"
    path.write_text(json.dumps(records))
    chosen = f"calibration.images={path}"
    result = run(command, files, chosen)
    assert result.status == 2
    assert "calibration.head" in result.err
    assert "left, nadir" in result.err
    left = estimated(command, files, chosen, "calibration.head='left'")
    assert np.abs(left - TRUTH_DEG).max() < 1e-4
    result = run(command, files, chosen, "calibration.head='left'", "camera.size_px=[1000,1024]", out="other")
    assert result.status == 2
    assert "1024 x 1024 px, camera.size_px 1000 x 1024" in result.err


def test_velocities_by_images_that_are_near_in_time(command: Command, files: Files) -> None:
    """A second image 0.2 s after the first, carried on by its velocity and rate."""
    rows = files.rows()
    second = dict(rows[0]) | {"file": "later.jpg", "t_s": f"{float(rows[0]['t_s']) + 0.2:.3f}"}
    second["latitude_deg"] = f"{float(rows[0]['latitude_deg']) + 12.0 / 111_200:.9f}"
    second["roll_deg"] = f"{float(rows[0]['roll_deg']) + 0.4:.4f}"
    files.write_rows([second, *rows])
    files.without_motion()
    clicked = [line.replace("antar_01.jpg", "later.jpg") for line in files.lines() if "antar_01.jpg" in line]
    files.write_lines([*files.lines(), *clicked])
    assert run(command, files, stage="simulate").status == 0
    o = BoresightObservations.load(Path("out/observations"))
    assert o.images[:2] == ("antar_01.jpg", "later.jpg")  # in the order of time
    assert o.knows_motion.tolist() == [True, True, *[False] * (len(o.images) - 2)]
    assert np.linalg.norm(o.navigation.velocity_w[0]) == pytest.approx(60.0, rel=0.01)
    assert np.rad2deg(o.navigation.rate_b[0]) == pytest.approx([2.0, 0.0, 0.0], abs=1e-3)
    assert not o.navigation.velocity_w[2:].any()


def test_a_time_offset_needs_velocities(command: Command, files: Files) -> None:
    files.without_motion()
    result = run(command, files)
    assert result.status == 0
    assert (
        "'with time offset' gave nothing: the velocity of 9 images is not known, the first is antar_01.jpg"
        in result.out
    )
    page = Path("out/report.html").read_text()
    assert 'alt="time_offset"' not in page
    assert "The velocity is not known of 9 of 9 images" in page
    alone = "estimator=[{name='boresight_adjustment', extra=['time_offset']}]"
    result = run(command, files, alone, out="alone")
    assert result.status == 1
    assert Path("alone/report.html").is_file()


def test_what_is_inseparable_is_said(command: Command, files: Files) -> None:
    """At one height and speed, with good navigation: the source's open question of Fig. 3.8."""
    good = ["stated.sigma_attitude_deg=[0.008,0.008,0.015]", "stated.sigma_position_m=[0.05,0.05,0.05]"]
    assert run(command, files, *good).status == 0
    assert "are not separable (correlation -0.99" in Path("out/report.html").read_text()
    metrics = pd.read_csv("out/metrics.csv", keep_default_na=False)
    row = metrics[metrics["quantity"] == "inseparable"].iloc[0]
    assert set(row["entity"].split(" and ")) == {"pitch", "time_offset"}
    assert abs(row["value"]) > 0.99


def test_a_time_offset_is_found_and_drawn(command: Command, files: Files) -> None:
    """Without noise even two heights are not needed; the curve starts from the result's own residuals."""
    write(fly(Conditions(is_exact=True, time_offset_s=0.01), stream(3, 0, "test")), files.folder)
    estimated(command, files)
    result = found(label="with time offset")
    assert result.names[3] == "time_offset"
    assert result.x[3] == pytest.approx(0.01, abs=5e-4)  # 1e-4 degrees of the file are 0.02 ms of way, times 20
    loaded = load_calibration(Path("out"), "test")
    held = time_offset_table(loaded, ADJUSTED).set_index("image").loc[ALL]
    at_zero = held[held["offset_ms"].abs() < 1e-9]["rms_px"].item()
    assert at_zero == pytest.approx(loaded.results[ADJUSTED].rms_px, rel=1e-9)
    corrected = time_offset_table(loaded, "with time offset")
    assert least(corrected).offset_ms == pytest.approx(10.0, abs=2.5)  # steps of 2.5 ms
    assert least(corrected).rms_px < at_zero


def test_images_without_ground_or_clicks_are_left_out(command: Command, files: Files) -> None:
    """One sees the horizon, one has a single click, one none, and one is not in the list."""
    files.change(2, roll_deg="100.0")
    lines, own = files.lines(), [line for line in files.lines() if "antar_04.jpg" in line]
    gone = {*own[1:], *(line for line in lines if "antar_05.jpg" in line)}
    stranger = lines[1].replace("antar_01.jpg", "stranger.jpg")
    files.write_lines([*(line for line in lines if line not in gone), stranger])
    result = run(command, files)
    assert result.status == 0, result.err
    said = {"antar_03.jpg": "points fall behind the camera", "antar_04.jpg": "1 points: a resection needs 2"}
    assert left_out(ADJUSTED) == said
    assert left_out("image by image") == said
    reading = left_out("")
    assert reading.pop("antar_05.jpg") == "no clicks in it"
    assert list(reading.values()) == ["not among the images"]
    assert np.abs(angles() - TRUTH_DEG).max() < 1e-4
    metrics = pd.read_csv("out/metrics.csv", keep_default_na=False)
    counted = metrics[metrics["quantity"] == "excluded"].set_index("entity")["value"].to_dict()
    assert counted == {"not among the images": 1, "no clicks in it": 1}


def test_navigation_of_another_image_strikes(command: Command, files: Files) -> None:
    files.change(4, roll_deg="3.5", pitch_deg="-2.5")
    assert run(command, files, "stated.sigma_attitude_deg=[0.008,0.008,0.015]").status == 0
    page = Path("out/report.html").read_text()
    assert "<b>antar_05.jpg</b>" in page
    assert "its navigation may be another image's" in page


def test_kappa_about_180_degrees(command: Command, files: Files) -> None:
    """Camera turned round, body by the rest: what is one angle stays near itself in the table."""
    write(fly(Conditions(vibration_deg=0.05), stream(3, 0, "test")), files.folder)
    lines = [line.split() for line in files.lines()]
    turned = [" ".join([*f[:3], *(f"{1023 - float(x):.4f}" for x in f[3:5]), *f[5:]]) for f in lines[1:]]
    files.write_lines([lines[0][0], *turned])
    for i, row in enumerate(files.rows()):
        files.change(i, heading_deg=f"{(float(row['heading_deg']) + TRUTH_DEG[2]) % 360:.4f}")
    assert run(command, files, "reference.boresight_deg=[-0.8,1.1,-180.0]").status == 0
    table = pd.read_csv("out/boresight.csv")
    kappa = table[table["name"] == "kappa"]
    assert kappa["value"].abs().max() > 180
    assert np.ptp(kappa["value"]) < 0.5
    assert kappa["error"].abs().max() < 0.5
    assert (kappa["reference"] == kappa["reference"].iloc[0]).all()


def test_a_second_run_comes_from_the_cache(command: Command, files: Files) -> None:
    folders = [Path("out/observations/boresight.npz"), Path("out/estimates") / ADJUSTED]
    estimated(command, files)
    before = [folder.stat().st_mtime_ns for folder in folders]
    assert "read  from cache" in run(command, files, stage="estimate").out
    assert before == [folder.stat().st_mtime_ns for folder in folders]
    files.change(0, height_m="1000.0")
    assert "another configuration" in run(command, files).err


def first_click(files: Files, column: int, value: str) -> None:
    lines = files.lines()
    fields = lines[1].split()
    fields[column] = value
    files.write_lines([lines[0], " ".join(fields), *lines[2:]])


def head_line(files: Files, text: str) -> None:
    files.write_lines([text, *files.lines()[1:]])


def rename(files: Files, old: str, new: str) -> None:
    files.images.write_text(files.images.read_text().replace(old, new))


def in_json(files: Files, text: str) -> None:
    (files.folder / "images.json").write_text(text)


def above(files: Files) -> None:
    lines = [line.split() for line in files.lines()]
    files.write_lines([lines[0][0], *(" ".join([*f[:2], "4000.0", *f[3:]]) for f in lines[1:])])


WRONG_FILES = [
    (lambda f: f.clicks.unlink(), "calibration.gcp_list: cannot read", "no such file"),
    (lambda f: f.clicks.write_bytes(b"\xff\xfe\x00"), "calibration.gcp_list", "not a text file"),
    (lambda f: f.clicks.write_text(""), "calibration.gcp_list", "empty; expected the projection"),
    (lambda f: f.write_lines(f.lines()[:1]), "calibration.gcp_list", "no clicks below the projection"),
    (lambda f: f.write_lines(f.lines()[1:]), "line 1", "expected a projection such as EPSG:32632"),
    (lambda f: f.write_lines([*f.lines(), "EPSG:32633"]), "a second projection", "'EPSG:32633'"),
    (lambda f: head_line(f, "EPSG:32631"), "km from the images", "is its projection 'EPSG:32631'?"),
    (lambda f: head_line(f, "EPSG:32634"), "longitude 23.5765", "its projection is 'EPSG:32634'"),
    (lambda f: head_line(f, "EPSG:4326"), "km from the other points", "'EPSG:4326'"),
    (lambda f: head_line(f, "EPSG:25832+5783"), "heights over a geoid", "undulation"),
    (lambda f: first_click(f, 3, "wide"), "line 2", "expected five numbers"),
    (lambda f: first_click(f, 0, "11.57"), "line 2", "km from the other points"),
    (lambda f: f.write_lines([*f.lines(), f.lines()[1]]), "is clicked in antar_01.jpg", "too"),
    (lambda f: f.write_lines([*f.lines(), "691600 5336200 560 5 5 antar_02.jpg P01"]), "has other coordinates", "P01"),
    (above, "lies above all images", "4000.0 m"),
    (lambda f: rename(f, "antar", "argos"), "none of its 72 clicks can be used", "not among the images"),
    (lambda f: f.images.unlink(), "calibration.images: cannot read", "no such file"),
    (lambda f: f.images.write_text(""), "calibration.images", "expected a head line"),
    (lambda f: f.images.write_text(f.images.read_text().splitlines()[0]), "calibration.images", "has no images"),
    (lambda f: rename(f, "heading_deg", "yaw_deg"), "has no 'heading_deg'", "line 2"),
    (lambda f: rename(f, "file,", "name,"), "has no name of an image under 'file'", "line 2"),
    (lambda f: rename(f, "rate_down_dps", "rate_dps"), "has no 'rate_down_dps'", "all six or none"),
    (lambda f: f.change(3, pitch_deg="up"), "line 5: pitch_deg should be a number from -90 to 90", "found 'up'"),
    (lambda f: f.change(3, t_s="nan"), "line 5: t_s should be a number", "found 'nan'"),
    (lambda f: f.change(3, latitude_deg="11.57,48.15"), "line 5", "expected 14 values as in the head line, got 15"),
    (lambda f: f.change(3, latitude_deg="91"), "latitude_deg should be a number from -80 to 84", "found '91'"),
    (lambda f: f.change(3, file="antar_01.jpg"), "line 5", "image antar_01.jpg is that of line 2 too"),
    (lambda f: f.change(3, t_s="0.0"), "line 5", "t_s 0.0 is that of line 2 too"),
]


@pytest.mark.parametrize(("wrong", "said", "and_said"), WRONG_FILES)
def test_wrong_files_are_one_line(command: Command, files: Files, wrong: object, said: str, and_said: str) -> None:
    assert callable(wrong)
    wrong(files)
    refused(run(command, files), said, and_said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[{", "not valid JSON"),
        ("{}", "expected a list of image records"),
        ("[]", "has no images"),
        ('[{"file": "a.jpg", "t_s": 1}]', "record 0: has no 'longitude_deg'"),
        ('[{"file": "a.jpg", "t_s": null}]', "record 0: t_s should be a number"),
    ],
)
def test_wrong_records_are_one_line(command: Command, files: Files, text: str, said: str) -> None:
    in_json(files, text)
    refused(run(command, files, f"calibration.images={files.folder / 'images.json'}"), said)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("calibration={gcp_list='a.txt', images='b.csv'}", "calibration.heading: say which north"),
        ("calibration.heading='north'", "calibration.heading: found 'north'"),
        ("calibration.head='mono'", "calibration.head"),
        ("calibration.undulation_m=300", "calibration.undulation_m"),
        ("calibration.heading_deg=3", "calibration.heading_deg: unknown key"),
        ("camera.distortion=[-9.5,0,0,0,0]", "camera.distortion: [-9.5, 0.0, 0.0, 0.0, 0.0] folds the image"),
        ("camera.focal_px=0", "camera.focal_px"),
        ("mounting.boresight_deg=[0,0]", "mounting.boresight_deg"),
        ("stated.sigma_px=0", "stated.sigma_px"),
        ("stated.constant_share=1", "stated.constant_share"),
        ("stated.sigma_attitude_deg=[0.1,0.1,-0.1]", "stated.sigma_attitude_deg.2"),
        ("reference.boresight_deg=[1,2]", "reference.boresight_deg"),
        ("estimator=[{name='sliding_window_adjustment'}]", "found 'sliding_window_adjustment'"),
        ("estimator=[{name='boresight_adjustment', extra=['clock']}]", "found 'clock'"),
        ("estimator=[]", "estimator"),
        ("estimator=[{name='boresight_adjustment'},{name='boresight_adjustment'}]", "is used 2 times"),
    ],
)
def test_wrong_settings_are_one_line(command: Command, files: Files, setting: str, said: str) -> None:
    refused(run(command, files, setting), said)


def refused(result: Result, *words: str) -> None:
    """Status 2, one line that says the words, and no folder."""
    assert result.status == 2, (result.out, result.err)
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, lines
    assert all(word in lines[0] for word in words), (words, lines[0])
    assert not Path("out").exists()
