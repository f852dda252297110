"""Pictures that are known, but not read: what each is, the bytes that tell it, and what reads or converts it."""

from __future__ import annotations

UNREAD_PICTURES: tuple[tuple[str, tuple[tuple[int, bytes], ...], str], ...] = (
    ("JPEG XR", ((0, b"II\xbc\x01"),), "save what imagecodecs.jpegxr_decode gives by numpy.save"),
    ("QOI", ((0, b"qoif"),), "convert it to PNG: magick IN.qoi OUT.png"),
    ("BPG", ((0, b"BPG\xfb"),), "convert it to PNG: bpgdec -o OUT.png IN.bpg"),
    ("a Photoshop document", ((0, b"8BPS"),), "save a flat copy of it as TIFF"),
    ("a GIMP picture", ((0, b"gimp xcf"),), "export it as PNG, TIFF or EXR"),
    ("an icon", ((0, b"\0\0\1\0"), (0, b"icns")), "save one of its pictures as PNG"),
    ("SGI's picture format", ((0, b"\x01\xda\0"), (0, b"\x01\xda\1")), "convert it to PNG: magick IN.rgb OUT.png"),
    ("Sun's raster format", ((0, b"\x59\xa6\x6a\x95"),), "convert it to PNG: magick IN.ras OUT.png"),
    ("DPX or Cineon", ((0, b"SDPX"), (0, b"XPDS"), (0, b"\x80\x2a\x5f\xd7")), "convert it: oiiotool IN -o OUT.tif"),
    ("a camera's raw file", ((0, b"FUJIFILMCCD-RAW"), (0, b"IIRO"), (0, b"IIU\0"), (4, b"ftypcrx")),
     "rawpy reads it: numpy.save(OUT, rawpy.imread(IN).raw_image)"),
    ("PDF or PostScript", ((0, b"%PDF-"), (0, b"%!PS")), "take the pictures out of it: pdfimages -all IN OUT"),
    ("a drawing (SVG)", ((0, b"<svg"),), "draw it as PNG: rsvg-convert IN.svg -o OUT.png"),
    ("a KTX texture", ((0, b"\xabKTX "),), "convert it to PNG: ktx extract IN OUT.png"),
    ("a film", ((4, b"ftypiso"), (4, b"ftypmp4"), (4, b"ftypqt"), (4, b"ftypM4V"), (0, b"\x1a\x45\xdf\xa3"),
                (8, b"AVI ")),
     "write its frames as pictures, ffmpeg -i IN frame%05d.png, and open their folder"),
)
