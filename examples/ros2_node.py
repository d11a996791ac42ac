"""A ROS 2 node: raw pictures of the cameras of an array come in, a depth image (REP 118) and its CameraInfo go out.

    lfgpu rectify pictures --calibration cameras.yaml -o rectified      # once
    python examples/ros2_node.py --ros-args -p rig:=rectified -p topics:="[/cam0/image_raw, /cam1/image_raw]"

The topics are in the order of the cameras of the calibration. Pictures are rgb8 or mono8, and have time stamps.
"""

import threading
from dataclasses import replace

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

import lfgpu
from lfgpu.calibration import RigWatch, camera_info, read_rectifier

CHANNELS = {"rgb8": 3, "mono8": 1}


def picture_of(message) -> np.ndarray:
    """The picture of a message, uint8 [y, x, c]."""
    channels = CHANNELS[message.encoding]
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    return rows[:, : message.width * channels].reshape(message.height, message.width, channels)


class DepthNode(Node):
    """Groups pictures by their stamps and publishes a depth image for each group."""

    def __init__(self) -> None:
        super().__init__("lfgpu")
        rig = self.declare_parameter("rig", "rectified").value
        topics = self.declare_parameter("topics", ["/cam0/image_raw"]).value
        tolerance = self.declare_parameter("tolerance", 0.01).value
        self.rectifier = read_rectifier(rig)
        shape = (*self.rectifier.size, self.rectifier.tones.shape[-1])
        self.grouper = lfgpu.FrameGrouper(len(topics), shape, tolerance=tolerance)
        self.depth = self.create_publisher(Image, "depth/image_rect", qos_profile_sensor_data)
        self.info = self.create_publisher(CameraInfo, "depth/camera_info", qos_profile_sensor_data)
        for camera, topic in enumerate(topics):
            self.create_subscription(Image, topic, self.recorder(camera), qos_profile_sensor_data)
        self.thread = threading.Thread(target=self.estimate, daemon=True)
        self.thread.start()

    def recorder(self, camera: int):
        """What is called with each picture of a camera."""

        def add(message) -> None:
            stamp = message.header.stamp
            self.grouper.add(camera, picture_of(message), stamp.sec + stamp.nanosec / 1e9)

        return add

    def estimate(self) -> None:
        """Estimate depth of groups until the grouper is closed; the first one starts the stream."""
        first = next(iter(self.grouper), None)
        if first is None:
            return
        pictures = self.rectifier.pictures(first.views)
        self.camera = camera_info(replace(pictures, geometry=self.rectifier.geometry))
        with (
            lfgpu.DepthStream(pictures, config="fast", rectifier=self.rectifier, on_result=self.publish) as stream,
            RigWatch(stream, on_finding=lambda said: self.get_logger().warning(" ".join(said))),
        ):
            for group in self.grouper:
                stream.push(group.views, valid=group.valid, tag=group.stamp)

    def publish(self, result) -> None:
        """Publish the depth of one frame: float32 metres, NaN where unknown, infinity beyond the horizon."""
        depth = self.rectifier.geometry.depth(result.numpy()).astype(np.float32)
        image = Image(height=depth.shape[0], width=depth.shape[1], encoding="32FC1", step=4 * depth.shape[1])
        image.data = depth.tobytes()
        seconds = int(result.tag)
        image.header.stamp.sec, image.header.stamp.nanosec = seconds, int(1e9 * (result.tag - seconds))
        image.header.frame_id = "lfgpu"
        camera = self.camera
        info = CameraInfo(header=image.header, width=camera.width, height=camera.height)
        info.distortion_model = camera.distortion_model
        info.d, info.k, info.r, info.p = (list(values) for values in (camera.d, camera.k, camera.r, camera.p))
        self.depth.publish(image)
        self.info.publish(info)


def main() -> None:
    rclpy.init()
    node = DepthNode()
    try:
        rclpy.spin(node)
    finally:
        node.grouper.close()
        node.thread.join()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
