"""XML parsing of untrusted documents; entity definitions are refused."""

import xml.etree.ElementTree as ET
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path

from ..errors import FormatError
from ..quoting import brief
from .files import read_bytes

Element = ET.Element
"""Type of XML elements for annotations, because only this file imports the parser."""


def read_xml(path: Path) -> Element:
    """Root element of a file in UTF-8, or in UTF-16 with a byte order mark.

    Document types are refused, because they can define entities that grow to gigabytes; camera
    files have none.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is not XML, or has a document type.
    """
    raw = read_bytes(path)
    wide = raw.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    try:
        text = raw.decode("utf-16" if wide else "utf-8-sig")
        if "<!DOCTYPE" in text:
            raise FormatError(
                f"{path} defines a document type, which no camera file has; expected plain XML. "
                "Export it again."
            )
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise FormatError(f"{path} is not XML: {brief(error)}. Copy or export it again.") from error
