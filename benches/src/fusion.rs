//! What merging costs: eight skins at 1 kHz in one process, and how it grows with contacts, against the same fusion in numpy.
//!
//! Time is simulated: reports come as fast as they are worked in. An update is the report of one skin with what it makes of the body:
//! the tracks, contacts, wrenches and torques, and the message in CDR. By default the node answers at most 1,000 times a second, so that
//! eight skins at 1 kHz are eight reports and one answer each millisecond. The peer works in the reports of a millisecond in one pass of
//! array operations over all skins, by the same estimator, gates and assignment. It makes no message, and neither judges what comes
//! from skins nor detects slip, nor waits for reports that overtake each other.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use dermis_body::{HistoryLimits, Robot};
use dermis_fusion::{Fuser, Settings, messages};
use dermis_msgs::Message;
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
use dermis_msgs::msg::{Contact, ContactArray};
use dermis_msgs::std_msgs::msg::Header;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

use crate::node::percentile;
use crate::peers;

mod peer;

/// Skins of the robot, each on a link of its own.
const SKINS: usize = 8;
/// \[ns\] when simulations begin, and between two reports of a skin.
const BEGIN: i64 = 1_700_000_000_000_000_000;
const PERIOD: i64 = 1_000_000;
/// Contacts on one skin, in turn.
const CONTACTS: [usize; 6] = [1, 10, 25, 50, 100, 200];

/// What to measure.
#[derive(Debug, Args)]
pub struct Options {
    /// Python with numpy and scipy; leaves the peer out where absent.
    #[arg(long)]
    peer_python: Option<PathBuf>,
    /// Root of the repository.
    #[arg(long, default_value = ".")]
    root: PathBuf,
    /// \[ms\] of simulated time of each measurement.
    #[arg(long, default_value_t = 5000)]
    milliseconds: usize,
}

/// Measures ours and the peer's.
///
/// # Errors
///
/// Where the peer fails or disagrees.
pub fn run(options: &Options) -> Result<Value> {
    let ours = at_one_kilohertz(options)?;
    eprintln!("dermis, 8 skins x 1 kHz: {ours}");
    let mut growth = Vec::new();
    for count in CONTACTS {
        growth.push(with_contacts(count, options.milliseconds / 5)?);
    }
    for row in &growth {
        eprintln!("dermis, one skin: {row}");
    }
    let each = |row: &Value| {
        row["update_us"].as_f64().unwrap_or(f64::NAN) / row["contacts"].as_f64().unwrap_or(f64::NAN)
    };
    let worst = growth.last().map_or(f64::NAN, &each);
    let at_50 = growth.iter().find(|r| r["contacts"] == 50).map_or(f64::NAN, each);
    let mut result = json!({
        "skins": SKINS, "rate_hz": 1000, "milliseconds": options.milliseconds, "dermis": ours, "contacts": &growth,
        "cost_per_contact_200_over_50": worst / at_50,
    });
    if let Some(python) = &options.peer_python {
        let run = peers::Run { python, root: &options.root, seconds: 3.0, threads: 1 };
        let found = run.of(peer::SCRIPT, &peer::scenes()?, peer::DEVIATION)?;
        let found = found.into_iter().map(|p| peer::beside(p, &result["dermis"], &growth));
        result["peers"] = json!(found.collect::<Result<Vec<_>>>()?);
        for row in result["peers"].as_array().into_iter().flatten() {
            eprintln!("{row}");
        }
    }
    Ok(result)
}

/// URDF and robot file of a robot with so many skins, each on an arm of its own.
fn robot_text(skins: usize) -> (String, String) {
    let mut urdf = "<robot name=\"r\"><link name=\"base\"/>".to_owned();
    let mut text = "schema = \"dermis-robot/1\"\nname = \"r\"\nurdf = \"r.urdf\"\n".to_owned();
    for i in 0..skins {
        urdf += &format!(
            "<link name=\"l{i}\"/><joint name=\"j{i}\" type=\"revolute\"><parent link=\"base\"/><child link=\"l{i}\"/>\
             <origin xyz=\"0 {i} 0\"/><axis xyz=\"0 0 1\"/><limit lower=\"-3\" upper=\"3\"/></joint>"
        );
        text += &format!(
            "[[skins]]\nname = \"s{i}\"\nmount = {{ parent = \"l{i}\", translation = [0.0, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }}\n"
        );
    }
    (urdf + "</robot>", text)
}

/// Writes such a robot into a folder; its file.
pub fn write_robot(folder: &Path, skins: usize) -> Result<PathBuf> {
    let (urdf, robot) = robot_text(skins);
    write_files(folder, &urdf, &robot)
}

/// Writes the texts of a URDF and a robot file into a folder; the path of the latter.
fn write_files(folder: &Path, urdf: &str, robot: &str) -> Result<PathBuf> {
    std::fs::write(folder.join("r.urdf"), urdf)?;
    let file = folder.join("r.toml");
    std::fs::write(&file, robot)?;
    Ok(file)
}

/// The fusion of a robot, from the texts of its files.
fn fuser_of(urdf: &str, robot: &str) -> Result<Fuser> {
    let folder = tempfile::tempdir()?;
    let robot = Robot::load(write_files(folder.path(), urdf, robot)?)?;
    Ok(Fuser::new(robot, Settings::default(), HistoryLimits::default(), &[], &[])?)
}

fn fuser(skins: usize) -> Result<Fuser> {
    let (urdf, robot) = robot_text(skins);
    let mut fuser = fuser_of(&urdf, &robot)?;
    fuser.assume_rest();
    Ok(fuser)
}

/// Contacts 25 mm apart, each with some noise.
fn report(skin: usize, sequence: u64, stamp: i64, contacts: usize, rng: &mut ChaCha8Rng) -> ContactArray {
    let mut noise = |size: f64| size * (rng.random::<f64>() - 0.5);
    let diagonal = |v: f64| std::array::from_fn(|i| if i % 4 == 0 { v } else { 0.0 });
    let contact = |k: usize| Contact {
        track_id: k as u32 + 1,
        position: Point {
            x: 0.025 * (k % 16) as f64 + noise(1e-3),
            y: 0.025 * (k / 16) as f64 + noise(1e-3),
            z: 0.0,
        },
        normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
        force: Vector3 { x: noise(0.2), y: noise(0.2), z: -3.0 + noise(0.2) },
        force_components: Contact::FORCE_FULL,
        position_covariance: diagonal(1e-6),
        force_covariance: diagonal(0.01),
        diameter: 0.01,
        confidence: 1.0,
        taxels: vec![1, 2, 3, 4],
    };
    ContactArray {
        header: Header { stamp: Time::from_nanos(stamp), frame_id: format!("s{skin}_skin") },
        skin: format!("s{skin}"),
        sequence,
        contacts: (0..contacts).map(contact).collect(),
        ..ContactArray::default()
    }
}

/// Mean, median, 99 of 100 and the longest.
fn summary(mut times: Vec<f64>) -> Value {
    times.sort_by(f64::total_cmp);
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    let at = |p: f64| percentile(&times, p);
    json!({ "mean": mean, "p50": at(50.0), "p99": at(99.0), "max": at(100.0) })
}

/// Two contacts on each of the skins.
fn at_one_kilohertz(options: &Options) -> Result<Value> {
    let mut fuser = fuser(SKINS)?;
    let robot = fuser.robot().clone();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut updates, mut whole) = (Vec::new(), Vec::new());
    let mut bytes = 0;
    for k in 0..options.milliseconds as u64 {
        let stamp = BEGIN + k as i64 * PERIOD;
        let reports: Vec<ContactArray> = (0..SKINS).map(|s| report(s, k + 1, stamp, 2, &mut rng)).collect();
        let begun = Instant::now();
        for (skin, report) in reports.iter().enumerate() {
            let one = Instant::now();
            fuser.take(skin, report, None, stamp + PERIOD / 10);
            // The last report of a millisecond is the one that is answered.
            if skin + 1 == SKINS {
                let state = fuser.state(stamp + PERIOD / 10);
                bytes = messages::body_contacts(&robot, &state, k).to_cdr().len();
                if k > 10 && state.contacts.len() != 2 * SKINS {
                    bail!("{} contacts of {}", state.contacts.len(), 2 * SKINS);
                }
                updates.push(one.elapsed().as_secs_f64() * 1e6);
            }
        }
        whole.push(begun.elapsed().as_secs_f64() * 1e6);
    }
    Ok(
        json!({ "update_us": summary(updates), "millisecond_us": summary(whole), "contacts": 2 * SKINS, "bytes": bytes }),
    )
}

/// So many contacts on one skin: \[µs\] of a report and its answer.
fn with_contacts(contacts: usize, reports: usize) -> Result<Value> {
    let mut fuser = fuser(1)?;
    let robot = fuser.robot().clone();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut times = Vec::new();
    for k in 0..reports as u64 {
        let stamp = BEGIN + k as i64 * PERIOD;
        let report = report(0, k + 1, stamp, contacts, &mut rng);
        let begun = Instant::now();
        fuser.take(0, &report, None, stamp);
        let state = fuser.state(stamp);
        let bytes = messages::body_contacts(&robot, &state, k).to_cdr().len();
        times.push(begun.elapsed().as_secs_f64() * 1e6);
        if k > 10 && (state.contacts.len() != contacts || bytes == 0) {
            bail!("{} contacts of {contacts}", state.contacts.len());
        }
    }
    let times = summary(times);
    Ok(json!({ "contacts": contacts, "update_us": times["p50"], "p99_us": times["p99"] }))
}
