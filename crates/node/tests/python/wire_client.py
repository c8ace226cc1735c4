"""Talks to a dermis node as two clients that others wrote: zenoh-ros2-sdk, which computes names, type
hashes and CDR by itself, and plain eclipse-zenoh.

usage: wire_client.py ENDPOINT DOMAIN NODE     exits 0 where everything passed
"""

import os
import sys
import threading
import time

WAIT = 20.0


def main(endpoint: str, domain: int, node: str) -> None:
    host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
    # The client must not need a router, and must not leave the machine.
    os.environ["ZENOH_CONFIG_OVERRIDE"] = (
        'mode="client";listen/endpoints=[];scouting/multicast/enabled=false'
    )
    import zenoh
    from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber

    namespace = node.rsplit("/", 1)[0]
    where = {"domain_id": domain, "router_ip": host, "router_port": int(port)}
    text = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data\n"}

    heard = threading.Event()
    words = []

    def listen(message) -> None:
        words.append(message.data)
        heard.set()

    subscriber = ROS2Subscriber(f"{namespace}/to_python", callback=listen, **text, **where)
    assert heard.wait(WAIT), "zenoh-ros2-sdk heard nothing"
    assert words[0] == "hello python", words
    print("zenoh-ros2-sdk: subscribed, type hash", subscriber.type_hash)

    publisher = ROS2Publisher(f"{namespace}/from_python", **text, **where)
    client = ROS2ServiceClient(
        f"{node}/tare",
        "std_srvs/srv/Trigger",
        request_definition=" ",
        response_definition="bool success\nstring message\n",
        # The SDK cannot hash a service without its package at hand.
        type_hash="RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
        timeout=WAIT,
        **where,
    )
    response = client.call(structure_needs_at_least_one_member=0)
    assert response is not None and response.success and response.message == "tared", response
    print("zenoh-ros2-sdk: called", f"{node}/tare")

    # Messages before the subscriber is matched are lost: say it until the time is over or it was heard.
    for _ in range(20):
        publisher.publish(data="hello rust")
        time.sleep(0.05)
    print("zenoh-ros2-sdk: published")

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        samples = []
        got = threading.Event()

        def take(sample) -> None:
            samples.append(sample)
            got.set()

        session.declare_subscriber(f"{domain}{namespace}/to_python/**", take)
        assert got.wait(WAIT), "eclipse-zenoh heard nothing"
        attachment = samples[0].attachment.to_bytes()
        assert len(attachment) == 33 and attachment[16] == 16, attachment
        payload = samples[0].payload.to_bytes()
        assert payload[:4] == b"\x00\x01\x00\x00", payload
        length = int.from_bytes(payload[4:8], "little")
        assert payload[8 : 8 + length - 1] == b"hello python", payload
        tokens = [
            str(reply.ok.key_expr)
            for reply in session.liveliness().get(f"@ros2_lv/{domain}/**")
            if reply.ok is not None
        ]
        assert any("/NN/" in token and token.endswith("/palm") for token in tokens), tokens
    print("eclipse-zenoh: payload, attachment and liveliness are those of rmw_zenoh")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
    # Threads of the clients may outlive the main one.
    sys.stdout.flush()
    os._exit(0)
