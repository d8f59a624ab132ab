"""EXIF of an image file, written by OpenCV and read by Pillow."""

from __future__ import annotations

import io
from datetime import datetime

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base

from sim.exif import exif_block
from sim.navigation import ImageRecord

RECORD = ImageRecord(
    file="mono-00003",
    system="antar",
    head="mono",
    line=0,
    burst=0,
    t_s=3.123456,
    time_utc="2010-06-01T10:00:03.123456+00:00",
    width_px=64,
    height_px=48,
    focal_px=2500.0,
    exposure_s=0.001,
    longitude_deg=-11.512345678,
    latitude_deg=48.102345678,
    height_m=1012.345,
    roll_deg=1.25,
    pitch_deg=-0.5,
    heading_deg=91.86,
)


def angle(dms: tuple[float, float, float]) -> float:
    return float(dms[0]) + float(dms[1]) / 60 + float(dms[2]) / 3600


def test_a_jpeg_says_when_and_where_it_was_taken() -> None:
    block = np.frombuffer(exif_block(RECORD), np.uint8)
    done, jpeg = cv2.imencodeWithMetadata(".jpg", np.zeros((48, 64), np.uint8), [cv2.IMAGE_METADATA_EXIF], [block])
    assert done
    exif = Image.open(io.BytesIO(jpeg.tobytes())).getexif()
    assert (exif[Base.Make], exif[Base.Model]) == ("antar", "mono")
    gps = exif.get_ifd(IFD.GPSInfo)
    assert (gps[GPS.GPSLatitudeRef], gps[GPS.GPSLongitudeRef]) == ("N", "W")
    # A millionth of a second of arc.
    assert angle(gps[GPS.GPSLatitude]) == pytest.approx(RECORD.latitude_deg, abs=2e-10)
    assert angle(gps[GPS.GPSLongitude]) == pytest.approx(-RECORD.longitude_deg, abs=2e-10)
    assert float(gps[GPS.GPSAltitude]) == pytest.approx(1012.345)
    own = exif.get_ifd(IFD.Exif)
    taken = datetime.strptime(f"{own[Base.DateTimeOriginal]}.{own[Base.SubsecTimeOriginal]}", "%Y:%m:%d %H:%M:%S.%f")
    assert taken == datetime.fromisoformat(RECORD.time_utc).replace(tzinfo=None)
    assert float(own[Base.ExposureTime]) == pytest.approx(0.001)
    assert own[Base.UserComment] == b"ASCII\0\0\0roll 1.250000 pitch -0.500000 true heading 91.860000"
