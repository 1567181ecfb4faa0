"""XML of an untrusted file as a plain tree that knows its lines.

defusedxml refuses entities and anything outside the file; SAX instead of ElementTree
because only its events tell the line.
"""

import dataclasses
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler

import defusedxml
import defusedxml.sax


@dataclasses.dataclass
class Node:
    """One XML element; text is not kept, URDF has none."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list["Node"] = dataclasses.field(default_factory=list)

    def all(self, tag: str) -> list["Node"]:
        """Children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> "Node | None":
        """First child with a tag: further ones do not count, as in ROS."""
        return next(iter(self.all(tag)), None)


class _Builder(ContentHandler):
    """Collect the events into nodes."""

    def __init__(self):
        super().__init__()
        self.open: list[Node] = [Node("", {}, 0)]

    def setDocumentLocator(self, locator):
        self.locator = locator

    def startElement(self, name, attrs):
        node = Node(name, dict(attrs.items()), self.locator.getLineNumber() or 0)
        self.open[-1].children.append(node)
        self.open.append(node)

    def endElement(self, name):
        self.open.pop()


def parse_xml(data: bytes) -> Node:
    """Root element.

    Raises:
        ValueError: If the text is not well-formed XML, or defines or uses entities.
    """
    builder = _Builder()
    try:
        defusedxml.sax.parseString(data, builder)
    except SAXParseException as error:
        where = f"line {error.getLineNumber()}"
        raise ValueError(f"not valid XML: {where}: {error.getMessage()}") from error
    except defusedxml.DefusedXmlException as error:
        raise ValueError(
            "XML entities and external references are not allowed in a robot file"
        ) from error
    # Encodings that are unknown, or not those of a text.
    except (LookupError, ValueError) as error:
        raise ValueError(f"not valid XML: {error}") from error
    return builder.open[0].children[0]
