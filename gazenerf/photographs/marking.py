"""Pictures that were altered say so in their metadata: XMP, EXIF and, in PNG, text."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from PIL import ExifTags, Image, PngImagePlugin

from gazenerf import __version__
from gazenerf.errors import UserError
from gazenerf.files import whole_file

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
ALTERED = "digitally altered: gaze redirected"
SOFTWARE = f"gazenerf {__version__}"

QUALITY = 95
"""Of JPEG and WebP, with colour at full resolution in JPEG."""

MOST_EXIF_BYTES = 60000
"""A JPEG segment holds 65533, the mark among them."""

INTEROPERABILITY = 0xA005
NOT_COPIED = (
    ExifTags.Base.Orientation, ExifTags.Base.Software, ExifTags.Base.ExifOffset,
    ExifTags.Base.GPSInfo, ExifTags.Base.ImageWidth, ExifTags.Base.ImageLength, INTEROPERABILITY,
)  # fmt: skip
NOT_COPIED_EXIF = (
    ExifTags.Base.MakerNote, ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight, INTEROPERABILITY,
)  # fmt: skip
"""What would no longer be true, or points at what is not copied; thumbnails are not copied either."""

XMP_HEADER = b"http://ns.adobe.com/xap/1.0/\0"
SOURCE_TYPE = "http://cv.iptc.org/newscodes/digitalsourcetype/compositeSynthetic"
"""IPTC's digital source type of a picture that is composed of elements of which at least one is synthetic."""

XMP = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmlns:dc="http://purl.org/dc/elements/1.1/"
 xmlns:Iptc4xmpExt="http://iptc.org/std/Iptc4xmpExt/2008-02-29/" xmlns:gazenerf="urn:gazenerf:redirect:1">
<xmp:CreatorTool>{software}</xmp:CreatorTool>
<dc:description><rdf:Alt><rdf:li xml:lang="x-default">{altered}</rdf:li></rdf:Alt></dc:description>
<Iptc4xmpExt:DigitalSourceType>{source_type}</Iptc4xmpExt:DigitalSourceType>
<gazenerf:RequestedGaze>{requested}</gazenerf:RequestedGaze>
</rdf:Description></rdf:RDF></x:xmpmeta>
<?xpacket end="w"?>"""


def check_picture_name(path: Path) -> None:
    """Refuse a name that no picture can be written as.

    Raises:
        UserError: the suffix is another one than .png, .jpg, .jpeg or .webp.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"cannot write a picture as {path.name}; name --out .png, .jpg or .webp")


def write_altered(path: Path, pixels: np.ndarray, source: Path | None, requested: str, mark: bool = True) -> None:
    """Write a redirected photograph.

    Args:
        path: .png keeps every pixel; .jpg and .webp are compressed anew.
        pixels: (H, W, 3) uint8 sRGB, upright.
        source: The photograph, whose EXIF is kept except what is no longer true; None keeps nothing.
        requested: The gaze that was asked for, in words.
        mark: Say in the metadata that the picture was altered.

    Raises:
        UserError: a suffix that is not written here, or an unwritable folder.
    """
    check_picture_name(path)
    exif = _exif(source, requested if mark else None)
    xmp = XMP.format(software=SOFTWARE, altered=ALTERED, source_type=SOURCE_TYPE, requested=escape(requested)).encode()
    options: dict[str, Any] = {"exif": exif.tobytes()} if len(exif) or mark else {}
    suffix = path.suffix.lower()
    if suffix == ".png":
        if mark:
            text = PngImagePlugin.PngInfo()
            text.add_text("Software", SOFTWARE)
            text.add_text("Comment", f"{ALTERED}; {requested}")
            text.add_itxt("XML:com.adobe.xmp", xmp.decode())
            options["pnginfo"] = text
    elif suffix == ".webp":
        options |= {"quality": QUALITY, **({"xmp": xmp} if mark else {})}
    else:
        options |= {"quality": QUALITY, "subsampling": 0}
        if mark:
            body = XMP_HEADER + xmp
            options["extra"] = b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body
    with whole_file(path) as temporary:
        Image.fromarray(pixels).save(temporary, **options)


def _exif(source: Path | None, requested: str | None) -> Image.Exif:
    """The photograph's EXIF without what is no longer true, and with the mark where a gaze is given."""
    exif = Image.Exif() if source is None else _kept_exif(source)
    if requested is not None:
        exif[ExifTags.Base.Software] = SOFTWARE
        exif[ExifTags.Base.ImageDescription] = f"{ALTERED}; {requested}"
    return exif


def _kept_exif(source: Path) -> Image.Exif:
    """What is still true of a photograph's EXIF; nothing where it is damaged or too long to be written again."""
    exif = Image.Exif()
    try:
        with warnings.catch_warnings(), Image.open(source) as image:
            warnings.simplefilter("ignore")
            old = image.getexif()
            for tag, value in old.items():
                if tag not in NOT_COPIED:
                    exif[tag] = value
            for ifd in (ExifTags.IFD.Exif, ExifTags.IFD.GPSInfo):
                kept = {tag: value for tag, value in old.get_ifd(ifd).items() if tag not in NOT_COPIED_EXIF}
                if kept:
                    exif.get_ifd(ifd).update(kept)
        return exif if len(exif.tobytes()) < MOST_EXIF_BYTES else Image.Exif()
    except Exception:  # Pillow raises errors of many kinds over EXIF that others wrote
        return Image.Exif()
