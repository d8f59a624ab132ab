"""A short flight with the mono camera through the command line: what it makes, what it says, what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
import rasterio
from PIL import Image

from estimators.aerial import gcp_file
from estimators.aerial.flight_boresight import BoresightFromControl, BoresightFromTies
from estimators.aerial.orthorectification import OrthoImages
from estimators.estimate import EstimationFailed
from scenarios import cli, spec
from sim.aerial.presets import PRESETS
from sim.flight_observations import FlightObservations
from sim.flight_simulation import simulate_flight
from sim.flight_truth import FlightTruth
from sim.scenario import ScenarioError
from sim.scenario.flight import Ground
from tests.scenarios.conftest import Command

SHORT = (
    "ground.preset=motorway",
    "ground.length_m=1500.0",
    "flight.system=antar",
    "flight.height_m=500.0",
    'flight.pattern={ kind = "strip", length_m = 60.0 }',
    "flight.frames=3",
    "control.points=6",
    "control.spread_m=80.0",
    "imaging.truth_images=true",
)


def arguments(*settings: str) -> list[str]:
    return [part for setting in (*SHORT, *settings) for part in ("--set", setting)]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight") / "run"
    assert cli.main(["run", "flight-town", "--out", str(folder), *arguments()]) == 0
    return folder


def metric(folder: Path, **where: str) -> pd.Series:
    table = pd.read_csv(folder / "metrics.csv", keep_default_na=False)
    for column, value in where.items():
        table = table[table[column] == value]
    assert len(table) == 1, where
    return table.iloc[0]


def test_geotiffs_have_zone_and_alpha_and_lie_where_the_flight_was(flown: Path) -> None:
    observations = FlightObservations.load(flown / "observations")
    files = sorted((flown / "estimates/orthorectification/orthos").glob("*.tif"))
    assert len(files) == 3
    at = observations.georeference.to_grid(observations.T_wc.t)
    for path, (east, north, _) in zip(files, at, strict=True):
        with rasterio.open(path) as raster:
            assert raster.crs.to_epsg() == 32632
            assert raster.count == 2
            assert raster.res == (0.2, 0.2)
            row, column = raster.index(east, north)
            assert raster.read(2)[row, column] == 255
    with rasterio.open(flown / "estimates/orthorectification/mosaic-mono.tif") as raster:
        assert raster.width * 0.2 > 200


def test_with_true_orientation_check_points_are_in_their_places(flown: Path) -> None:
    largest = metric(flown, quantity="ortho", axis="all", statistic="max", unit="px", entity="true orientation")
    assert float(largest["value"]) < 0.1
    measured = metric(flown, quantity="ortho", axis="all", statistic="rms", unit="m", entity="measured orientation")
    # 0.015 and 0.010 degrees of boresight and 0.1 m of position at 500 m.
    assert 0.05 < float(measured["value"]) < 0.5


def test_what_was_written_shows_the_errors_that_were_foretold(flown: Path) -> None:
    matched = metric(flown, quantity="ortho_matched", axis="all", statistic="median")
    assert int(matched["n"]) > 20
    # Of patches of 160 px, by phase correlation.
    assert float(matched["value"]) < 0.15


def test_images_tell_where_they_were_taken(flown: Path) -> None:
    records = json.loads((flown / "observations/images.json").read_text())
    assert [r["head"] for r in records] == ["mono"] * 3
    path = flown / "observations/images" / records[0]["file"]
    assert np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)).shape == (1024, 1024)
    with Image.open(path) as image:
        gps = image.getexif().get_ifd(0x8825)
    latitude = float(gps[2][0] + gps[2][1] / 60 + gps[2][2] / 3600)
    assert latitude == pytest.approx(records[0]["latitude_deg"], abs=1e-8)


def test_clicks_are_where_the_signals_are(flown: Path) -> None:
    truth, _ = FlightTruth.load(flown / "truth")
    observations = FlightObservations.load(flown / "observations")
    clicks = gcp_file.read(flown / "observations/gcp_list.txt")
    names = [r.file for r in observations.records]
    camera = observations.cameras[0].camera
    found = gcp_file.in_world(clicks, names, camera, observations.georeference, 0.5)
    assert len(found.points) >= 9
    assert not found.excluded
    X = found.X_w[found.points.point]
    true = truth.cameras[0].camera
    uv = np.stack([true.project(truth.T_wc[i].inv().apply(x)) for i, x in zip(found.points.image, X, strict=True)])
    # 0.5 px of clicking and 0.02 m of DGPS, 0.1 px, in each coordinate.
    assert 0.25 < np.std(found.points.uv - uv) < 0.9
    # The picture is bright there.
    for k in range(3):
        image = np.asarray(cv2.imread(str(flown / "observations/images" / names[k]), cv2.IMREAD_GRAYSCALE))
        own = np.rint(uv[found.points.image == k]).astype(int)
        signals = np.array([image[v - 1 : v + 2, u - 1 : u + 2].max() for u, v in own])
        assert np.median(signals) > 180


def test_vehicles_are_those_of_the_pictures(flown: Path) -> None:
    _, vehicles = FlightTruth.load(flown / "truth")
    assert set(vehicles["image"]) == {0, 1, 2}
    seen = vehicles[vehicles["hidden"] < 0.1]
    area = seen["length_m"] * seen["width_m"] / 0.2**2
    # A car is as large as its roof, and a little more for its side.
    assert 0.7 < float(np.median(seen["pixels"] / area)) < 1.8


def test_road_map_is_wrong_on_purpose(flown: Path) -> None:
    known, true = (
        json.loads((flown / part / "roads.geojson").read_text())["features"] for part in ("observations", "truth")
    )
    truth, _ = FlightTruth.load(flown / "truth")
    errors = truth.map_errors
    assert len(known) == len(errors.source)
    assert len(true) == np.count_nonzero(errors.source >= 0) + len(errors.missing)
    k = int(np.flatnonzero(errors.source >= 0)[0])
    here, there = (np.array(f["geometry"]["coordinates"][0]) for f in (known[k], true[int(errors.source[k])]))
    # 111 km a degree of latitude.
    assert 0 < np.hypot(*(here - there)) * 111e3 < 15


def test_road_masks_cover_the_roads(flown: Path) -> None:
    masks = sorted((flown / "estimates/road_masks/masks").glob("*.png"))
    assert [p.name for p in masks] == [f"mono-0000{k}.png" for k in range(3)]
    where = {"estimator": "road_masks", "quantity": "road_mask"}
    completeness, correctness = (
        float(metric(flown, statistic=s, **where)["value"]) for s in ("completeness", "correctness")
    )
    # Margins and displacement of the map: neither is one.
    assert 0.7 < completeness <= 1
    assert 0.3 < correctness < 0.95


def test_depth_of_the_pictures_is_that_of_the_ground(flown: Path) -> None:
    truth, _ = FlightTruth.load(flown / "truth")
    for k in range(3):
        with np.load(flown / f"truth/images/mono-0000{k}.npz") as f:
            depth, instance = f["depth"], f["instance"]
        ground = np.argwhere(instance == -1)[::5000]
        p_c = truth.cameras[0].camera.unproject(ground[:, ::-1].astype(float), depth[tuple(ground.T)])
        p_w = truth.T_wc[k].apply(p_c)
        # Depth of float32 at 500 m; the renderer's ground is linear over 8 px.
        np.testing.assert_allclose(p_w[:, 2], truth.terrain.height(p_w[:, :2]), atol=0.02)


def test_a_flight_is_the_same_every_time() -> None:
    one, other = (simulate_flight(spec.read("flight-town", SHORT).without_estimators) for _ in range(2))
    assert one.observations.records == other.observations.records
    np.testing.assert_array_equal(one.truth.T_wc.R, other.truth.T_wc.R)
    np.testing.assert_array_equal(one.world_s, other.world_s)


def test_traffic_rests_while_the_aircraft_turns() -> None:
    settings = ('flight.pattern={ kind = "approaches", length_m = 60.0 }', "flight.frames=100")
    flown = simulate_flight(spec.read("flight-town", (*SHORT, *settings)).without_estimators)
    lines = np.array([r.line for r in flown.observations.records])
    assert set(lines) == {0, 1, 2, 3}
    for line in range(4):
        own = lines == line
        np.testing.assert_allclose(np.diff(flown.world_s[own]), np.diff(flown.truth.t_s[own]), atol=1e-9)
    between = np.flatnonzero(np.diff(lines))
    assert np.all(np.diff(flown.truth.t_s)[between] > 30)
    assert np.all((np.diff(flown.world_s)[between] > 0) & (np.diff(flown.world_s)[between] < 6))


def test_report_holds_tables_and_figures(flown: Path) -> None:
    page = (flown / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") == 4
    assert 'src="http' not in page
    assert 'href="http' not in page
    errors = pd.read_parquet(flown / "errors.parquet")
    assert {"attitude", "position", "ortho"} == set(errors["quantity"])


def test_second_run_takes_all_from_cache_and_estimators_do_not_redraw(
    flown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (flown / "observations/images/mono-00000.jpg").stat().st_mtime_ns
    assert cli.main(["run", "flight-town", "--out", str(flown), *arguments()]) == 0
    assert "simulate  from cache" in capsys.readouterr().out
    assert (flown / "observations/images/mono-00000.jpg").stat().st_mtime_ns == before


def test_a_damaged_image_is_counted_and_named(flown: Path, tmp_path: Path) -> None:
    from estimators.aerial.orthorectification import Orthorectification

    observations = FlightObservations.load(flown / "observations")
    for record in observations.records[1:]:
        (tmp_path / "images").mkdir(exist_ok=True)
        content = (flown / "observations/images" / record.file).read_bytes()
        (tmp_path / "images" / record.file).write_bytes(content if record.file.endswith("1.jpg") else content[:40])
    result = Orthorectification(mosaic=False)(observations, tmp_path, tmp_path / "out", lambda: None)
    assert isinstance(result, OrthoImages)
    assert result.image.tolist() == [1]
    assert [f.reason for f in result.failures] == [
        "images/mono-00000.jpg: no such file or directory",
        "images/mono-00002.jpg: not an image, or damaged",
    ]


@pytest.mark.parametrize("estimator", [BoresightFromControl, BoresightFromTies])
def test_a_camera_that_did_not_fly_gives_no_boresight(estimator: type[Any], flown: Path, tmp_path: Path) -> None:
    source = flown / "observations"
    result = estimator(camera="nadir")(FlightObservations.load(source), source, tmp_path, lambda: None)
    assert result == EstimationFailed("no image of a camera 'nadir'")


def test_presets_of_the_language_are_those_of_the_world() -> None:
    field = Ground.model_fields["preset"].annotation
    assert set(PRESETS) == set(field.__args__[0].__args__)  # type: ignore[union-attr]  # of Literal | None


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("ground.preset=flight-twon",), "ground.preset: found 'flight-twon', did you mean 'flight-town'?"),
        (("ground.roads=nowhere.geojson",), "ground.roads: give either a preset or roads"),
        (("flight.cameras=['nadir']",), "flight.cameras: found 'nadir', allowed: mono, thermal"),
        (("flight.pattern.offset_m=[90000.0, 0.0]",), "leads away from the ground"),
        (("control.points=900", "control.spread_m=10.0"), "control.points: 900 wanted"),
        (("navigation.time_offset_s=2.0",), "navigation.time_offset_s: should be less than or equal to 1"),
        (("estimator.0.method=fast",), "estimator.0.method"),
        (("estimator.0.gsd_m=0.0",), "estimator.0.gsd_m: expected 0.005 to 100"),
        (("estimator.0.name=sliding_window_adjustment",), "estimator.0.name: found 'sliding_window_adjustment'"),
    ],
)
def test_wrong_input_is_one_line(settings: tuple[str, ...], said: str, command: Command) -> None:
    result = command("run", "flight-town", *arguments(*settings))
    assert result.status == 2
    assert said in result.err.replace("\n", " ")
    assert result.err.count("\n") == 1
    assert not list(Path.cwd().iterdir())


def test_a_map_that_is_missing_or_none_is_one_line(command: Command, tmp_path: Path) -> None:
    broken = tmp_path / "broken.geojson"
    broken.write_text("{")
    for name in ("nowhere.geojson", "broken.geojson"):
        result = command("run", "flight-map", "--set", f"ground.roads={name}")
        assert result.status == 2
        assert name in result.err
        assert result.err.count("\n") == 1


def test_shipped_flights_are_valid() -> None:
    found = [name for name, path in spec.names().items() if path.parent.name == "flights"]
    assert {"flight-town", "flight-map"} <= set(found)
    for name in found:
        assert spec.read(name).kind == "flight"


def test_terrain_with_a_broken_geotiff_is_one_line(command: Command, tmp_path: Path) -> None:
    (tmp_path / "heights.tif").write_bytes(b"II*\0nothing")
    result = command("run", "flight-map", "--set", "ground.terrain=['heights.tif']")
    assert result.status == 2
    assert "heights.tif" in result.err
    assert result.err.count("\n") == 1


def test_unknown_keys_name_the_nearest() -> None:
    with pytest.raises(ScenarioError, match=r"flight\.hight_m: unknown key, did you mean 'height_m'"):
        spec.read("flight-town", ["flight.hight_m=500.0"])


def test_boresight_from_control_and_from_ties_of_rendered_images(tmp_path: Path) -> None:
    settings = ("ground.length_m=1500.0", "flight.frames=12", "flight.height_m=500.0", "control.points=8")
    lines = 'flight.pattern={ kind = "approaches", length_m = 40.0 }'
    folder = tmp_path / "run"
    both = [part for setting in (*settings, lines) for part in ("--set", setting)]
    assert cli.main(["run", "flight-calibration", "--out", str(folder), *both]) == 0
    for label, limits in (
        ("boresight_from_gcps", (0.03, 0.03, 0.06)),
        ("boresight_from_ties", (0.06, 0.06, 0.4)),
    ):
        for angle, limit in zip(("omega", "phi", "kappa"), limits, strict=True):
            where = {"estimator": label, "quantity": "boresight", "axis": angle}
            bias, sigma = (float(metric(folder, statistic=s, **where)["value"]) for s in ("bias", "sigma"))
            assert abs(bias) < 4 * sigma
            assert sigma < limit / 2
    table = pd.read_csv(folder / "metrics.csv", keep_default_na=False)
    assert not len(table[table["quantity"] == "ortho"])
    assert "boresight.png" in {p.name for p in (folder / "figures").iterdir()}


def test_a_flight_without_control_has_no_boresight_from_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    given = ("control.points=0", 'estimator=[{ name = "boresight_from_gcps" }]')
    assert cli.main(["run", "flight-town", "--out", str(folder), *arguments(*given)]) == 1
    assert "no control points were clicked in this flight" in capsys.readouterr().out


def test_ground_that_ends_under_an_image_is_counted(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    world = simulate_flight(spec.read("flight-town", SHORT).without_estimators).world
    x0, _, x1, _ = world.roads.bounds_m
    # An image shows 205 m: the line begins 200 m before the end of the ground.
    edge = world.terrain.bounds_m[2] - (x0 + x1) / 2 - 100.0
    line = f'flight.pattern={{ kind = "strip", length_m = 200.0, offset_m = [{edge}, 0.0] }}'
    given = (line, "control.points=0", "flight.speed_mps=150.0", "flight.frames=6")
    assert cli.main(["run", "flight-town", "--out", str(folder), *arguments(*given)]) == 0
    made = int(metric(folder, quantity="ortho", statistic="made")["value"])
    failed = int(metric(folder, quantity="ortho", statistic="failed")["value"])
    assert made + failed == 6
    assert min(made, failed) > 0
    errors = pd.read_parquet(folder / "errors.parquet")
    reasons = errors.loc[errors["quantity"] == "failure", "axis"]
    assert len(reasons) == failed
    assert reasons.str.contains("no ground under .* of 64 points").all()


@pytest.mark.shared_data
def test_a_flight_over_real_roads_and_buildings(shared_data: Path, tmp_path: Path) -> None:
    maps = shared_data / "roads"
    folder = tmp_path / "run"
    given = (
        f"ground.roads={maps / 'helsinki.geojson'}",
        f"ground.buildings={maps / 'helsinki-buildings.geojson'}",
        "flight.system=antar",
        "flight.height_m=500.0",
        "flight.frames=2",
    )
    settings = [part for setting in given for part in ("--set", setting)]
    assert cli.main(["run", "flight-map", "--out", str(folder), *settings]) == 0
    observations = FlightObservations.load(folder / "observations")
    # Helsinki lies at 24.9 E.
    assert observations.georeference.epsg == 32635
    largest = metric(folder, quantity="ortho", axis="all", statistic="max", unit="px", entity="true orientation")
    assert float(largest["value"]) < 0.1
    image = np.asarray(cv2.imread(str(folder / "observations/images/mono-00000.jpg"), cv2.IMREAD_GRAYSCALE))
    assert image.std() > 15
