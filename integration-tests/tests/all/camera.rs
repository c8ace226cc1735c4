//! A camera of this machine (Video4Linux 2) in front of the thumb's node. No machine of ours has one: what the kernel would answer is preloaded
//! into the program ([camera.c](../../camera/camera.c)).

#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use dermis_insight::wire::PictureWriter;
use dermis_integration_tests::{Peer, finish, listen, open_node, program, root};
use dermis_msgs::sensor_msgs::msg::CompressedImage;
use dermis_node::Qos;
use dermis_sensor::Encoder;
use dermis_skin::{Frame, Image, PixelFormat};

const SOON: Duration = Duration::from_secs(40);
/// Twice the size of the thumb's pictures.
const SIZE: [u32; 2] = [820, 616];

/// A folder with the camera, its picture and the node's skin.
struct Bench {
    folder: tempfile::TempDir,
    driver: PathBuf,
    picture: Vec<u8>,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let driver = path("camera.so");
        let source = root().join("integration-tests/camera/camera.c");
        finish(Command::new("cc").args(["-shared", "-fPIC", "-o"]).arg(&driver).arg(source).arg("-ldl"));
        let picture = jpeg();
        std::fs::write(path("picture"), &picture).unwrap();
        std::fs::write(path("video"), "").unwrap();
        let skin = std::fs::read_to_string(root().join("launch/skins/insight-thumb.toml")).unwrap();
        let wire = r#"protocol = "insight-jpeg""#;
        assert!(skin.contains(wire));
        std::fs::write(path("thumb.toml"), skin.replace(wire, r#"protocol = "mjpeg""#)).unwrap();
        Self { folder, driver, picture }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The node, with the camera set so; its log is its standard error.
    fn start(&self, query: &str, kind: &str) -> Peer {
        self.start_with(&self.path("video"), query, kind)
    }

    /// The same with this device file.
    fn start_with(&self, device: &Path, query: &str, kind: &str) -> Peer {
        let mut command = Command::new(program("dermis"));
        command.current_dir(root()).args(["insight", "--skin"]).arg(self.path("thumb.toml")).arg("--source");
        command.arg(format!("v4l2://{}{query}", device.display()));
        command.env("LD_PRELOAD", &self.driver).env("CAMERA", self.folder.path()).env("CAMERA_KIND", kind);
        Peer::start(command.stderr(Stdio::piped()))
    }
}

/// A picture that is darker at its left.
fn jpeg() -> Vec<u8> {
    let [width, height] = SIZE;
    let data: Vec<u8> = (0..width * height * 3).map(|i| (i / 3 % width / 4) as u8).collect();
    let mut frame = Frame::new(0, 0, Vec::new());
    frame.image = Image::new(width, height, PixelFormat::Rgb8, data);
    // Its length stands before it on the original wire.
    PictureWriter::default().encode(&frame, 0).unwrap()[4..].to_vec()
}

#[test]
fn its_pictures_come_through_and_it_may_be_unplugged() {
    let bench = Bench::new();
    let viewer = open_node("viewer");
    let (_subscription, pictures) =
        listen::<CompressedImage>(&viewer, "image/compressed", Qos::sensor_data());
    let mut node = bench.start("?size=820x616&rate=40", "MJPG");
    node.expect_error("820x616, 40 pictures a second", SOON);
    let next = || pictures.recv_timeout(SOON).unwrap();
    assert!(next().data == bench.picture, "a picture is not the one that the camera sent");
    // One in five is damaged, which leaves 32 a second; a machine that is busy takes fewer. They may come to this test in bursts.
    let taken = |picture: &CompressedImage| picture.header.stamp.as_nanos();
    let begun = taken(&next());
    let all: Vec<_> = (0..30).map(|_| next()).collect();
    assert!(all.iter().all(|picture| picture.data.len() == bench.picture.len()));
    let lasted = all.last().map_or(0, taken) - begun;
    assert!(lasted > 600_000_000, "{lasted} ns");

    let unplugged = bench.path("unplugged");
    std::fs::write(&unplugged, "").unwrap();
    node.expect_error("video went away: it was unplugged, or lost power", SOON);
    node.expect_error("video: plug the camera in, or look for it under /dev/v4l/by-id", SOON);
    while pictures.try_recv().is_ok() {}
    std::fs::remove_file(&unplugged).unwrap();
    assert!(next().data == bench.picture);
    node.interrupt();
    assert!(node.end(SOON).success());
}

#[test]
fn what_it_cannot_is_said() {
    let bench = Bench::new();
    for (query, kind, said) in [
        ("?size=640x480", "MJPG", "has no pictures of 640x480: take size=820x616"),
        ("", "YUYV", "does not compress its pictures (it has YUYV)"),
        ("?rate=90", "MJPG", "50 pictures a second where 90 were asked for"),
    ] {
        bench.start(query, kind).expect_error(said, SOON);
    }
    bench
        .start_with(Path::new("/dev/surely-not-a-camera"), "", "MJPG")
        .expect_error("there is no /dev/surely-not-a-camera", SOON);
}
