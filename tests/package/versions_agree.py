# SPDX-License-Identifier: Apache-2.0
#
# Goal: the version number has one home. Method: each package.xml must repeat the one of
# include/agnocast/version.hpp.
import pathlib
import re
import sys
import xml.etree.ElementTree as xml

root = pathlib.Path(sys.argv[1])
header = (root / "include/agnocast/version.hpp").read_text()
parts = [
    re.search(rf"AGNOCAST_VERSION_{part} (\d+)", header).group(1)
    for part in ("MAJOR", "MINOR", "PATCH")
]
expected = ".".join(parts)
for manifest in (root / "package.xml", *sorted(root.glob("ros2/*/package.xml"))):
    found = xml.parse(manifest).findtext("version")
    if found != expected:
        sys.exit(
            f"{manifest.relative_to(root)} says {found}, include/agnocast/version.hpp says "
            f"{expected}"
        )
print("version", expected)
