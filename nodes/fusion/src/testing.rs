//! Simulated robots, touches and skins, for tests.

use std::path::{Path, PathBuf};

use dermis_body::{HistoryLimits, Robot};
use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::msg::{Contact as ContactMsg, ContactArray};
use dermis_msgs::std_msgs::msg::Header;
use dermis_skin::{Contact, ForceComponents, Stamp};
use nalgebra::{Matrix3, Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::fuser::{BodyState, Fuser};
use crate::settings::Settings;

pub(crate) mod arm;
pub(crate) mod square;

/// \[ns\]
pub(crate) const MS: i64 = 1_000_000;
/// When simulations begin.
pub(crate) const BEGIN: Stamp = 1_700_000_000_000_000_000;

/// Chest with two skins that overlap, and an upper arm on a joint about z through (0, 0, 0.5), with one skin.
pub(crate) fn robot() -> Robot {
    let folder = tempfile::tempdir().unwrap();
    Robot::load(write_robot(folder.path())).unwrap()
}

/// Writes the files of [`robot`] into a folder; the path of the robot file.
pub(crate) fn write_robot(folder: &Path) -> PathBuf {
    let urdf = r#"<robot name="r"><link name="base"/><link name="chest"/><link name="plate"/><link name="arm"/>
        <joint name="neck" type="fixed"><parent link="base"/><child link="chest"/><origin xyz="0 0 0.3"/></joint>
        <joint name="screw" type="fixed"><parent link="chest"/><child link="plate"/><origin xyz="0.1 0 0" rpy="0 0 0.5"/></joint>
        <joint name="shoulder" type="continuous"><parent link="chest"/><child link="arm"/><origin xyz="0 0 0.2"/>
          <axis xyz="0 0 1"/></joint></robot>"#;
    let text = r#"
        schema = "dermis-robot/1"
        name = "r"
        urdf = "r.urdf"
        [[skins]]
        name = "a"
        mount = { parent = "chest", translation = [0.0, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }
        [[skins]]
        name = "b"
        mount = { parent = "plate", translation = [0.0, 0.02, 0.0], rpy = [0.0, 0.0, 0.3] }
        [[skins]]
        name = "c"
        mount = { parent = "arm", translation = [0.3, 0.0, 0.0], rpy = [0.0, 0.0, 0.0] }
    "#;
    std::fs::write(folder.join("r.urdf"), urdf).unwrap();
    let file = folder.join("r.toml");
    std::fs::write(&file, text).unwrap();
    file
}

pub(crate) fn fuser(settings: Settings) -> Fuser {
    Fuser::new(robot(), settings, HistoryLimits::default(), &[], &[]).unwrap()
}

/// The same, where a file states this rate \[Hz\] for every skin.
pub(crate) fn stated(rate: f64) -> Fuser {
    let mut robot = robot();
    robot.skins.iter_mut().for_each(|skin| skin.rate = Some(rate));
    Fuser::new(robot, Settings::default(), HistoryLimits::default(), &[], &[]).unwrap()
}

/// A frame of a skin of [`robot`].
pub(crate) fn report(skin: &str, sequence: u64, stamp: Stamp, contacts: &[Contact]) -> ContactArray {
    ContactArray {
        header: Header { stamp: Time::from_nanos(stamp), frame_id: format!("{skin}_skin") },
        skin: skin.to_owned(),
        sequence,
        contacts: contacts.iter().map(ContactMsg::from).collect(),
        ..ContactArray::default()
    }
}

/// A contact that presses with `force` \[N\] along the normal, z, and of which everything is known.
pub(crate) fn contact(track: u32, x: f64, y: f64, force: f64) -> Contact {
    let mut contact = Contact::at(Point3::new(x, y, 0.0), Vector3::z());
    contact.track_id = track;
    contact.diameter = 0.01;
    contact.force = Vector3::new(0.0, 0.0, -force);
    contact.force_components = ForceComponents::Full;
    contact.position_covariance = Matrix3::from_diagonal_element(1e-6);
    contact.force_covariance = Matrix3::from_diagonal_element(0.01);
    contact
}

/// A touch of the chest, in its frame, z up.
#[derive(Debug, Clone)]
pub(crate) struct Touch {
    pub from: f64,
    pub to: f64,
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    pub force: Vector3<f64>,
}

impl Touch {
    pub(crate) fn resting(from: f64, to: f64, x: f64, y: f64, force: f64) -> Self {
        let position = Vector3::new(x, y, 0.0);
        Self { from, to, position, velocity: Vector3::zeros(), force: Vector3::new(0.0, 0.0, -force) }
    }

    /// On at `t` \[s\].
    pub(crate) fn lasts(&self, t: f64) -> bool {
        (self.from..self.to).contains(&t)
    }

    /// Goes on for `dt` \[s\] as the filter's model says.
    fn step(&mut self, dt: f64, s: &Settings, rng: &mut ChaCha8Rng) {
        let (f, q) = crate::track::slide(dt, s);
        // Lower triangle of the noise of one axis.
        let l00 = q[(0, 0)].sqrt();
        let l10 = q[(3, 0)] / l00;
        let l11 = (q[(3, 3)] - l10 * l10).max(0.0).sqrt();
        for i in 0..3 {
            let (a, b) = (normal(rng), normal(rng));
            self.position[i] += f[(0, 3)] * self.velocity[i] + l00 * a;
            self.velocity[i] = f[(3, 3)] * self.velocity[i] + l10 * a + l11 * b;
            self.force[i] += s.force_change * dt.sqrt() * normal(rng);
        }
    }
}

pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// How a skin reads.
#[derive(Debug, Clone)]
pub(crate) struct SimSkin {
    /// Index on [`robot`].
    pub index: usize,
    /// \[Hz\]
    pub rate: f64,
    /// \[s\] least and largest delay from acquisition to arrival.
    pub delay: (f64, f64),
    /// \[m\] standard deviation of a position, as it reports it.
    pub position: f64,
    /// \[N\] the same of a force component.
    pub force: f64,
    /// Chance that a frame misses a contact.
    pub miss: f64,
    /// Chance that a frame has a contact too many.
    pub clutter: f64,
    /// Chance that it takes a contact for a new one.
    pub rename: f64,
}

impl SimSkin {
    pub(crate) fn good(index: usize) -> Self {
        Self {
            index,
            rate: [100.0, 70.0, 50.0][index],
            delay: (0.001, 0.012),
            position: 1e-3,
            force: 0.1,
            miss: 0.0,
            clutter: 0.0,
            rename: 0.0,
        }
    }
}

/// Errors of a skin that stay for one touch.
#[derive(Debug, Clone, Copy)]
struct Stays {
    position: Vector3<f64>,
    force: Vector3<f64>,
    name: u32,
}

/// What is simulated.
#[derive(Debug, Clone)]
pub(crate) struct Scenario {
    pub seed: u64,
    /// \[s\]
    pub duration: f64,
    pub touches: Vec<Touch>,
    pub skins: Vec<SimSkin>,
    pub settings: Settings,
    /// Whether touches move and change as the filter's model says.
    pub moves: bool,
    /// \[Hz\] of answers.
    pub rate: f64,
}

/// What comes from a simulation each time that the fuser is called.
pub(crate) struct Moment<'a> {
    pub t: f64,
    /// Touches that last, as they are at the instant of the answer; with their index.
    pub truth: Vec<(usize, Touch)>,
    pub state: &'a BodyState,
    /// The last frame of each skin, in the frame of the chest.
    pub last: &'a [Vec<Vector3<f64>>],
}

struct Arrival {
    at: Stamp,
    skin: usize,
    message: ContactArray,
}

impl Scenario {
    /// Simulates, and shows every answer to `look`.
    pub(crate) fn run(&self, mut look: impl FnMut(&Moment<'_>)) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let mut fuser = fuser(self.settings);
        let step = 1.0 / 1000.0;
        let steps = (self.duration / step).round() as usize;
        // What the touches are at each millisecond.
        let mut touches = self.touches.clone();
        let mut history: Vec<Vec<Touch>> = Vec::new();
        if self.moves {
            for _ in 0..=steps {
                history.push(touches.clone());
                touches.iter_mut().for_each(|touch| touch.step(step, &self.settings, &mut rng));
            }
        }
        let at = |t: f64| -> &[Touch] {
            let k = (t / step).round() as usize;
            history.get(k).map_or(self.touches.as_slice(), Vec::as_slice)
        };
        let mut arrivals = self.arrivals(at, &mut rng);
        arrivals.sort_by_key(|a| a.at);
        let mut next = arrivals.into_iter().peekable();
        let mut last: Vec<Vec<Vector3<f64>>> = vec![Vec::new(); 3];
        let poses = fuser.robot().body.poses(&[0.0]);
        let chest = fuser.robot().body.link("chest").unwrap();
        let chest_from_skin: Vec<_> =
            fuser.robot().skins.iter().map(|s| poses.between(chest, s.link) * s.pose).collect();
        drop(poses);
        let asks = (self.duration * self.rate) as usize;
        for k in 1..asks {
            let t = k as f64 / self.rate;
            let now = BEGIN + (t * 1e9) as i64;
            while let Some(arrival) = next.next_if(|a| a.at <= now) {
                let points = arrival
                    .message
                    .contacts
                    .iter()
                    .map(|c| (chest_from_skin[arrival.skin] * Contact::from(c).position).coords);
                last[arrival.skin] = points.collect();
                fuser.take(arrival.skin, &arrival.message, None, arrival.at);
            }
            let state = fuser.state(now);
            let instant = (state.stamp - BEGIN) as f64 * 1e-9;
            let truth = at(instant).iter().cloned().enumerate().filter(|(_, touch)| touch.lasts(instant));
            look(&Moment { t, truth: truth.collect(), state: &state, last: &last });
        }
    }

    fn arrivals<'a>(&self, at: impl Fn(f64) -> &'a [Touch], rng: &mut ChaCha8Rng) -> Vec<Arrival> {
        let robot = robot();
        let poses = robot.body.poses(&[0.0]);
        let chest = robot.body.link("chest").unwrap();
        let s = &self.settings;
        let mut all = Vec::new();
        for skin in &self.skins {
            let on_body = &robot.skins[skin.index];
            let skin_from_chest = (poses.between(chest, on_body.link) * on_body.pose).inverse();
            let share = s.systematic_share;
            let fixed = (skin.position.powi(2) * share + s.mount_deviation.powi(2)).sqrt();
            let mut stays: Vec<Stays> = self
                .touches
                .iter()
                .zip(1..)
                .map(|(touch, name)| {
                    let position = Vector3::from_fn(|_, _| fixed * normal(rng));
                    let force = Vector3::from_fn(|i, _| {
                        (skin.force.powi(2) * share + (s.gain_deviation * touch.force[i]).powi(2)).sqrt()
                            * normal(rng)
                    });
                    Stays { position, force, name }
                })
                .collect();
            let mut names = self.touches.len() as u32 + 1;
            let (mut k, mut arrived) = (0_u64, 0);
            loop {
                k += 1;
                let t = ((k as f64 + 0.2 * rng.random::<f64>()) / skin.rate * 1000.0).round() / 1000.0;
                if t >= self.duration {
                    break;
                }
                let mut contacts = Vec::new();
                let free = (1.0 - share).sqrt();
                for (touch, stays) in at(t).iter().zip(&mut stays) {
                    if !touch.lasts(t) || rng.random::<f64>() < skin.miss {
                        continue;
                    }
                    if rng.random::<f64>() < skin.rename {
                        stays.name = names;
                        names += 1;
                    }
                    let noise = Vector3::from_fn(|_, _| skin.position * free * normal(rng));
                    let position = touch.position + stays.position + noise;
                    let force =
                        touch.force + stays.force + Vector3::from_fn(|_, _| skin.force * free * normal(rng));
                    contacts.push(sensed(stays.name, position, force, skin, &skin_from_chest));
                }
                if rng.random::<f64>() < skin.clutter {
                    let position =
                        Vector3::new(rng.random::<f64>() * 0.4 - 0.2, rng.random::<f64>() * 0.4 - 0.2, 0.0);
                    contacts.push(sensed(names, position, -Vector3::z(), skin, &skin_from_chest));
                    names += 1;
                }
                let stamp = BEGIN + (t * 1e9) as i64;
                let delay = skin.delay.0 + (skin.delay.1 - skin.delay.0) * rng.random::<f64>();
                // A skin's own messages do not overtake each other.
                arrived = (stamp + (delay * 1e9) as i64).max(arrived);
                let message = report(&on_body.name, k, stamp, &contacts);
                all.push(Arrival { at: arrived, skin: skin.index, message });
            }
        }
        all
    }
}

fn sensed(
    name: u32,
    position: Vector3<f64>,
    force: Vector3<f64>,
    skin: &SimSkin,
    skin_from_chest: &nalgebra::Isometry3<f64>,
) -> Contact {
    let mut contact = contact(name, 0.0, 0.0, 0.0);
    contact.position = skin_from_chest * Point3::from(position);
    contact.normal = skin_from_chest.rotation * Vector3::z();
    contact.force = skin_from_chest.rotation * force;
    contact.position_covariance = Matrix3::from_diagonal_element(skin.position.powi(2));
    contact.force_covariance = Matrix3::from_diagonal_element(skin.force.powi(2));
    contact
}
