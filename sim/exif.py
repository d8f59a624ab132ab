"""The metadata of an image as EXIF, for ``cv2.imwriteWithMetadata`` or any other writer that takes the raw block."""

from __future__ import annotations

from datetime import datetime

from PIL.ExifTags import GPS, IFD, Base
from PIL.Image import Exif
from PIL.TiffImagePlugin import IFDRational

from sim.navigation import ImageRecord

# UserComment begins with its encoding.
_ASCII = b"ASCII\0\0\0"


def exif_block(record: ImageRecord) -> bytes:
    """EXIF 2.3 with time, exposure and GPS position; the attitude, for which EXIF has no tag, in the comment.

    The block begins with the TIFF header, as OpenCV wants it; a JPEG's segment has "Exif" and two zeros before it.
    """
    time = datetime.fromisoformat(record.time_utc)
    exif = Exif()
    exif[Base.Make], exif[Base.Model] = record.system, record.head
    exif.get_ifd(IFD.Exif).update(
        {
            Base.DateTimeOriginal: time.strftime("%Y:%m:%d %H:%M:%S"),
            Base.SubsecTimeOriginal: time.strftime("%f"),
            Base.ExposureTime: IFDRational(round(record.exposure_s * 1e6), 1_000_000),
            Base.ExifImageWidth: record.width_px,
            Base.ExifImageHeight: record.height_px,
            Base.UserComment: _ASCII
            + f"roll {record.roll_deg:.6f} pitch {record.pitch_deg:.6f} true heading {record.heading_deg:.6f}".encode(),
        }
    )
    exif.get_ifd(IFD.GPSInfo).update(
        {
            GPS.GPSLatitudeRef: "N" if record.latitude_deg >= 0 else "S",
            GPS.GPSLatitude: _sexagesimal(record.latitude_deg),
            GPS.GPSLongitudeRef: "E" if record.longitude_deg >= 0 else "W",
            GPS.GPSLongitude: _sexagesimal(record.longitude_deg),
            GPS.GPSAltitudeRef: b"\0" if record.height_m >= 0 else b"\1",
            GPS.GPSAltitude: IFDRational(round(abs(record.height_m) * 1000), 1000),
            GPS.GPSMapDatum: "WGS-84",
        }
    )
    return exif.tobytes().removeprefix(b"Exif\0\0")


def _sexagesimal(angle_deg: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees, minutes and seconds of the magnitude; a millionth of a second of arc is 0.03 mm."""
    micro = round(abs(angle_deg) * 3.6e9)
    minutes, seconds = divmod(micro, 60_000_000)
    return IFDRational(minutes // 60), IFDRational(minutes % 60), IFDRational(seconds, 1_000_000)
