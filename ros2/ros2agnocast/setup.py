# SPDX-License-Identifier: Apache-2.0
import pathlib
import xml.etree.ElementTree as xml

from setuptools import setup

name = "ros2agnocast"
manifest = xml.parse(pathlib.Path(__file__).resolve().with_name("package.xml"))

setup(
    name=name,
    version=manifest.findtext("version"),
    description=manifest.findtext("description"),
    maintainer=manifest.findtext("maintainer"),
    maintainer_email=manifest.find("maintainer").get("email"),
    license=manifest.findtext("license"),
    packages=[name, f"{name}.command"],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
    ],
    install_requires=["setuptools", "ros2cli"],
    tests_require=["pytest"],
    zip_safe=True,
    entry_points={
        "ros2cli.command": [f"agnocast = {name}.command.agnocast:AgnocastCommand"],
    },
)
