"""Contacts as obstacles: the point cloud of a skin, or of the fusion, in a grid around the robot.

python3 cloud.py --ros-args -p frame:=baro_grid_link -p cell:=0.002

The cloud is read as PCL, OctoMap and Nav2 read it: by the names and offsets of its fields. Each point that presses with more than
`least` newtons marks one cell of a grid in the cloud's own frame, as `nav_msgs/OccupancyGrid` on `touched_cells`. A robot that has
a TF tree transforms the points into the frame of its map first, as those programs do.
"""

import math
import struct

import rclpy
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2, PointField


def points(cloud, names):
    """The float32 fields of these names, one tuple a point."""
    fields = {field.name: field for field in cloud.fields}
    for name in names:
        if name not in fields or fields[name].datatype != PointField.FLOAT32:
            raise ValueError(f"the cloud has no float32 field `{name}`")
    order = ">" if cloud.is_bigendian else "<"
    data = bytes(cloud.data)
    for i in range(cloud.width * cloud.height):
        at = (i // cloud.width) * cloud.row_step + (i % cloud.width) * cloud.point_step
        yield tuple(struct.unpack_from(order + "f", data, at + fields[name].offset)[0] for name in names)


class Cells(Node):
    def __init__(self):
        super().__init__("touched_cells")
        self.cell = self.declare_parameter("cell", 0.05).value  # [m]
        self.side = self.declare_parameter("side", 0.1).value  # [m]
        self.least = self.declare_parameter("least", 0.1).value  # [N]
        self.publisher = self.create_publisher(OccupancyGrid, "touched_cells", 10)
        self.create_subscription(PointCloud2, "contact_points", self.mark, qos_profile_sensor_data)

    def mark(self, cloud):
        cells = round(self.side / self.cell)
        grid = OccupancyGrid()
        grid.header = cloud.header
        grid.info.resolution = self.cell
        grid.info.width = grid.info.height = cells
        grid.info.origin.position.x = grid.info.origin.position.y = -self.side / 2
        grid.info.origin.orientation.w = 1.0
        occupied = [0] * (cells * cells)
        for x, y, force in points(cloud, ("x", "y", "intensity")):
            # A force that is not known (NaN) counts as one.
            if force < self.least:
                continue
            column, row = (math.floor((v + self.side / 2) / self.cell) for v in (x, y))
            if 0 <= column < cells and 0 <= row < cells:
                occupied[row * cells + column] = 100
                print(f"occupied {column} {row} in {cloud.header.frame_id}", flush=True)
        grid.data = occupied
        self.publisher.publish(grid)


rclpy.init()
try:
    rclpy.spin(Cells())
except KeyboardInterrupt:
    pass
