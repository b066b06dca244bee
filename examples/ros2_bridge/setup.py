"""Package of ROS 2; colcon build installs its nodes, launch file and parameters."""

from glob import glob

from setuptools import setup

NAME = "pcs_racing_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The pcs-racing founders",
    description="Simulator and planner nodes of pcs-racing, with the topics of f1tenth_gym_ros",
    license="MIT",
    entry_points={
        "console_scripts": [
            f"simulator = {NAME}.nodes:simulator",
            f"planner = {NAME}.nodes:planner",
        ]
    },
)
