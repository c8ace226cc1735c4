"""What a lab writes in place of a dermis node: rclpy, numpy and ONNX Runtime, with the same wire, model and message.

    rclpy_node.py SKIN.toml BUNDLE /dev/pts/N

It decodes, takes a zero at start, normalises, runs the model and publishes, and nothing else: no channel health, no drift,
no clock mapping, no identities, no diagnostics.
"""

import binascii
import os
import struct
import sys
import tomllib
import tty

import numpy as np
import onnxruntime
import rclpy
from dermis_msgs.msg import Contact, ContactArray
from rclpy.qos import qos_profile_sensor_data

ZERO_FRAMES = 200
HEADER = struct.Struct("<BBHIQ")


def unstuff(data):
    out = bytearray()
    i, n = 0, len(data)
    while i < n:
        code = data[i]
        out += data[i + 1 : i + code]
        i += code
        if code < 255 and i < n:
            out.append(0)
    return out


def main():
    skin = tomllib.load(open(sys.argv[1], "rb"))
    bundle = tomllib.load(open(os.path.join(sys.argv[2], "bundle.toml"), "rb"))
    noise = skin["noise"]
    threshold = skin.get("condition", {}).get("contact_threshold", 4.0)
    mean = np.array(bundle["input"]["mean"], np.float32)
    scale = np.array(bundle["input"]["scale"], np.float32)
    values = {v["name"]: v for v in bundle["output"]["values"]}
    names = list(values)
    out_mean = np.array([v["mean"] for v in values.values()])
    out_scale = np.array([v["scale"] for v in values.values()])
    sigma = values["position.x"]["sigma"]
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        os.path.join(sys.argv[2], "model.onnx"), options, providers=["CPUExecutionProvider"]
    )

    rclpy.init()
    node = rclpy.create_node("lab_node")
    publisher = node.create_publisher(ContactArray, "contacts", qos_profile_sensor_data)
    line = os.open(sys.argv[3], os.O_RDONLY | os.O_NOCTTY)
    tty.setraw(line)

    zero, taken = np.zeros(len(mean)), []
    rest = b""
    while rclpy.ok():
        *frames, rest = (rest + os.read(line, 65536)).split(b"\0")
        for stuffed in frames:
            frame = unstuff(stuffed)
            if len(frame) < HEADER.size + 2:
                continue
            if binascii.crc_hqx(frame[:-2], 0xFFFF) != int.from_bytes(frame[-2:], "little"):
                continue
            _, _, channels, sequence, _ = HEADER.unpack_from(frame)
            reading = np.frombuffer(frame, np.float32, channels, HEADER.size)
            message = ContactArray()
            message.header.stamp = node.get_clock().now().to_msg()
            message.header.frame_id = skin["frame_id"]
            message.skin = skin["name"]
            message.sequence = sequence
            if len(taken) < ZERO_FRAMES:
                taken.append(reading)
                zero = np.mean(taken, axis=0)
                message.status = ContactArray.STATUS_UNCALIBRATED
            else:
                signal = reading - zero
                if np.sqrt(np.mean(np.square(signal / noise))) > threshold:
                    features = ((signal - mean) / scale).astype(np.float32)[None]
                    (answer,) = session.run(None, {"input": features})
                    found = dict(zip(names, answer[0] * out_scale + out_mean))
                    contact = Contact()
                    contact.position.x = float(found["position.x"])
                    contact.position.y = float(found["position.y"])
                    contact.normal.z = 1.0
                    contact.force.z = -float(found["force.normal"])
                    contact.position_covariance[0] = contact.position_covariance[4] = sigma**2
                    message.contacts.append(contact)
            publisher.publish(message)


if __name__ == "__main__":
    main()
