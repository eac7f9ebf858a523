# SPDX-License-Identifier: Apache-2.0
import pathlib
import xml.etree.ElementTree as xml

from setuptools import setup

name = "agnocast_launch"
manifest = xml.parse(pathlib.Path(__file__).resolve().with_name("package.xml"))

setup(
    name=name,
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    maintainer=manifest.findtext("maintainer"),
    maintainer_email=manifest.find("maintainer").get("email"),
    license=manifest.findtext("license"),
    packages=[name],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    tests_require=["pytest"],
    zip_safe=True,
)
