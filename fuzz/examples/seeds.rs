//! Writes the first inputs of every fuzz target, from real encodings, into `corpus/`.

use std::fs;
use std::path::{Path, PathBuf};

use dermis_bag::BagWriter;
use dermis_fuzz::messages::{kinds, selector};
use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
use dermis_msgs::msg::{Contact, ContactArray, SkinGeometry, TaxelFrame};
use dermis_msgs::std_msgs::msg::Header;
use dermis_msgs::{Message, TypeSupport};
use dermis_transport::framing::{NativeEncoder, NativeFormat};

type Done<T = ()> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Done {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let seeds = Seeds { corpus: here.join("corpus"), root: here.join("..") };
    seeds.frames()?;
    seeds.messages()?;
    seeds.bags()?;
    seeds.files()?;
    seeds.limits()
}

struct Seeds {
    corpus: PathBuf,
    root: PathBuf,
}

impl Seeds {
    fn put(&self, target: &str, name: &str, parts: &[&[u8]]) -> Done {
        let folder = self.corpus.join(target);
        fs::create_dir_all(&folder)?;
        fs::write(folder.join(name), parts.concat())?;
        Ok(())
    }

    fn frames(&self) -> Done {
        let values = [101_325.0, f32::NAN, -1.0, 0.0];
        for (name, format) in [
            ("f32", NativeFormat::F32),
            ("u16", NativeFormat::U16),
            ("i32", NativeFormat::I32),
            ("u12", NativeFormat::U12),
        ] {
            let mut encoder = NativeEncoder::new(format);
            let mut stream = b"noise".to_vec();
            let mut pieces = Vec::new();
            // A loss, a restart, and a clock that goes back.
            for (sequence, time) in [(7, 1000), (8, 11_000), (11, 41_000), (0, 20), (1, 10_020), (2, 5)] {
                let bytes = encoder.encode(sequence, time, &values)?;
                stream.extend_from_slice(bytes);
                let mut raw = cobs::decode_vec(&bytes[..bytes.len() - 1]).map_err(|e| e.to_string())?;
                raw.truncate(raw.len() - 2);
                pieces.push(u8::try_from(raw.len())?);
                pieces.extend_from_slice(&raw);
            }
            self.put("frames", name, &[&[3 << 1, 6, 10], &stream])?;
            self.put("frames", &format!("{name}-sealed"), &[&[0x80 | 3 << 1, 40, 10], &pieces])?;
        }
        // Frames in three parts each, of which one is lost, one comes late and one twice; any number of channels is read.
        let mut datagrams = Vec::new();
        for sequence in 0..4 {
            let mut encoder = NativeEncoder::new(NativeFormat::U16);
            encoder.encode_parts(sequence, 10 * u64::from(sequence), &[7.0; 50], 64, |part| {
                datagrams.push(part.to_vec())
            })?;
        }
        datagrams.swap(3, 6);
        datagrams.remove(7);
        datagrams.push(datagrams[0].clone());
        self.put("frames", "parts", &[&[0x40, 60, 10], &datagrams.concat()])?;
        let lines = b"# a device\n1,2,3,nan\n4 5 6 7\r\n$GPGGA,1,2*3\n-1e-3;.5;+7;1e30\n1,2\n";
        self.put("frames", "lines", &[&[1 | 3 << 1, 5, 100], lines])?;
        let lines = b"\n4294967295,10,1.5\n0,20,2.5\n0,20,2.5\n7,70,3\n2,5,1\n";
        self.put("frames", "lines-with-time", &[&[0x41, 5, 100], lines])
    }

    /// A message of every type, and some that are full.
    fn messages(&self) -> Done {
        for kind in kinds() {
            let bytes = (kind.support.json_to_cdr)(&serde_json::json!({}))?;
            self.message(kind.support, "", &bytes)?;
        }
        let header = Header::new(1_700_000_000_123_456_789, "palm");
        let contact = Contact {
            track_id: 3,
            position: Point { x: 0.01, y: -0.02, z: 0.0 },
            force: Vector3 { x: 0.0, y: 0.1, z: -2.0 },
            confidence: f32::NAN,
            taxels: vec![1, 2],
            ..Contact::default()
        };
        let array = ContactArray {
            header: header.clone(),
            skin: "pad".into(),
            contacts: vec![contact],
            ..Default::default()
        };
        let frame = TaxelFrame {
            header,
            skin: "pad".into(),
            layout_id: 1,
            values: vec![101_325.0, f32::NAN],
            flags: vec![0, 2],
            ..Default::default()
        };
        let geometry = SkinGeometry {
            points: vec![Point::default(); 2],
            triangles: vec![0, 1, 1],
            channels: vec!["t0".into(), "t1".into()],
            ..Default::default()
        };
        self.message(TypeSupport::of::<ContactArray>(), "-full", &array.to_cdr())?;
        self.message(TypeSupport::of::<TaxelFrame>(), "-full", &frame.to_cdr())?;
        self.message(TypeSupport::of::<SkinGeometry>(), "-full", &geometry.to_cdr())
    }

    fn message(&self, support: &TypeSupport, suffix: &str, bytes: &[u8]) -> Done {
        let name = format!("{}{suffix}", support.name.replace('/', "-"));
        let chosen = selector(support.name).to_le_bytes();
        self.put("cdr", &name, &[&chosen, bytes])?;
        let json = serde_json::to_vec(&(support.cdr_to_json)(bytes)?)?;
        self.put("json", &name, &[&chosen, &json])
    }

    fn bags(&self) -> Done {
        let scratch = tempfile::tempdir()?;
        let folder = scratch.path().join("presses");
        let mut writer = BagWriter::create(&folder)?;
        writer.set_custom("origin", "a seed");
        let frame = TaxelFrame { values: vec![1.0, 2.0], ..TaxelFrame::default() };
        for i in 0..3 {
            writer.write("taxels", &frame, 1_700_000_000_000_000_000 + i)?;
        }
        writer.write("/header", &Header::new(1, "palm"), 1_700_000_000_000_000_100)?;
        writer.finish()?;
        let mcap = fs::read(folder.join("presses_0.mcap"))?;
        self.put("bag", "whole", &[&mcap])?;
        self.put("bag", "cut", &[&mcap[..mcap.len() / 2]])?;
        self.put("bag", "sqlite", &[b"SQLite format 3\0"])?;
        self.put("metadata", "kilted", &[&fs::read(folder.join("metadata.yaml"))?])
    }

    /// What lies in the repository for people to copy.
    fn files(&self) -> Done {
        for (choice, folder) in [("s", "launch/skins"), ("p", "launch/plans"), ("b", "models/baro-grid")] {
            for entry in fs::read_dir(self.root.join(folder))? {
                let path = entry?.path();
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                if name.ends_with(".toml") {
                    self.put("config", &format!("{choice}-{name}"), &[choice.as_bytes(), &fs::read(&path)?])?;
                }
            }
        }
        let toml = "t skin = 'pad.toml'\nsource = 'udp://0.0.0.0:7400'\nname = 'pad'\nnamespace = '/left'\nmodels = ['a']\n\
                    masked = ['t1']\nforce_threshold = 0.1\nstrict = true\nautostart = false\ndomain_id = 7\n\
                    localhost_only = true\nuse_sim_time = false\ndevice_time = true\nremap = ['contacts:=touch']\n\
                    [runtime]\nchoice = 'embedded'\nlibrary = 'x.so'\n[parameters]\ncontact_threshold = 5.5\n";
        self.put("config", "t-node", &[toml.as_bytes()])?;
        let yaml = "y\nskin: pad.toml\nsource: \"udp://0.0.0.0:7400\"\nmodels: [a, b]\nautostart: false\n\
                    parameters: {contact_threshold: 5.5}\nruntime:\n  choice: embedded\nremap:\n  - contacts:=touch\n";
        self.put("config", "y-node", &[yaml.as_bytes()])?;
        for (name, url) in [
            ("serial", "serial:///dev/ttyACM0?baud=921600&parity=even&stop=2&idle=2.5"),
            ("udp", "udp://[::]:7400?from=192.168.1.20"),
            ("tcp", "tcp://skin.local:7400?idle=0"),
            ("listen", "tcp://0.0.0.0:7400?listen"),
            ("v4l2", "v4l2:///dev/video0?size=1640x1232&rate=40&idle=2"),
            ("pty", "pty://?link=/tmp/skin%20a"),
            ("replay", "replay:///data/bag?speed=0.5&topic=/skin/taxels&loop=true"),
        ] {
            self.put("config", &format!("u-{name}"), &[b"u", url.as_bytes()])?;
        }
        Ok(())
    }

    /// What took all memory or time once, and the smallest of each kind that is right.
    fn limits(&self) -> Done {
        for (target, folder, prefix) in [
            ("skin", "launch/skins", ""),
            ("plan", "launch/plans", ""),
            ("labels", "launch/labels", ""),
            ("bundle", "models/baro-grid", ""),
            ("launch", "launch", "y"),
        ] {
            for entry in fs::read_dir(self.root.join(folder))? {
                let path = entry?.path();
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                if name.ends_with(".toml") || name.ends_with(".launch.yaml") {
                    self.put(target, &name, &[prefix.as_bytes(), &fs::read(&path)?])?;
                }
            }
        }
        let skin = fs::read_to_string(self.root.join("launch/skins/baro-line.toml"))?;
        for (name, from, to) in [
            (
                "size",
                "surface = {",
                "surface = { type = \"rectangle\", size = [1e300, 1e-300], spacing = 0.002 } # {",
            ),
            ("rate", "rate = ", "rate = 1e300 # "),
            ("noise", "noise = ", "noise = 1e-300 # "),
        ] {
            self.put("skin", name, &[skin.replacen(from, to, 1).as_bytes()])?;
        }
        let plan = "schema = \"dermis-plan/1\"\nname = \"some\"\ndiameter = 0.004\n[[steps]]\n";
        self.put(
            "plan",
            "count",
            &[plan.as_bytes(), b"kind = \"presses\"\ncount = 4000000000\nforce = [0.1, 0.5]\n"],
        )?;
        let slow = b"kind = \"slides\"\ncount = 1\nforce = [0.1, 0.5]\nlength = [1e300, 1e300]\nspeed = [1e-300, 1e-300]\n";
        self.put("plan", "slow", &[plan.as_bytes(), slow])?;
        let mut laughs = "yprocesses: &a0 [{name: a}]\n".to_owned();
        for i in 1..=9 {
            laughs += &format!("x{i}: &a{i} [{}]\n", vec![format!("*a{}", i - 1); 9].join(", "));
        }
        self.put("launch", "laughs", &[laughs.as_bytes()])?;
        let itself = vec!["{include: {file: launch.yaml, arguments: {a: '${a}${a}'}}}"; 4].join(", ");
        let text = format!("yarguments: {{a: xx}}\nprocesses: [{itself}]\n");
        self.put("launch", "itself", &[text.as_bytes()])?;
        let pattern = b"yprocesses: [{name: a, program: sh, ready: {line: '(((a{100}){100}){100}){100}'}}]\n";
        self.put("launch", "pattern", &[pattern])?;
        let stl = b"ssolid t\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid t\n";
        self.put("mesh", "text", &[stl])?;
        let mut binary = vec![b's'];
        binary.extend([b' '; 80]);
        // It says four billion triangles and holds one.
        binary.extend(u32::MAX.to_le_bytes());
        for v in [0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            binary.extend(v.to_le_bytes());
        }
        binary.extend([0, 0]);
        self.put("mesh", "binary", &[&binary])?;
        self.put("mesh", "tray", &[b"ov 0 0 0\nv 10 0 0\nv 10 8 0\nv 0 8 0\nf 1 2 3\nf 1 3 4\n"])?;
        self.put("mesh", "far", &[b"ov 0 0 0\nv 1e38 0 0\nv 1 1e38 0\nf 1 2 3\n"])
    }
}
