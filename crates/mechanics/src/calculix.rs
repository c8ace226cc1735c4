//! CalculiX as a reference: finite elements of others, on the same questions.
//!
//! CalculiX CrunchiX (`ccx`, <http://www.calculix.de>) is a solver that shares no code, no elements and no way of thinking
//! with this crate. Where it is installed, [`layer_cases`], [`block_cases`], [`dome_cases`], [`shell_cases`] and
//! [`panel_cases`] ask it what this crate claims to know, and answer with both figures. All of it takes some seconds.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use nalgebra::{Point3, Vector3};

use crate::MechanicsError;

mod block;
mod dome;
mod faces;
mod layer;
mod plate;
mod quadratic;
mod shell;

pub use block::{PadReadings, block_cases, pad_readings};
pub use dome::dome_cases;
pub use layer::layer_cases;
pub use plate::{Plate, plate_deflections};
pub use shell::{Panel, PanelTimes, Touch, panel_cases, panel_times, shell_cases, touch_readings};

/// Debian's package, and what the instructions say to install.
const INSTALL: &str = "install CalculiX (Debian and Ubuntu: apt-get install calculix-ccx)";

/// Why CalculiX has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalculixError {
    /// It is not installed.
    #[error("no program `ccx` on the path: {INSTALL}")]
    Missing,
    /// Its files cannot be written or read.
    #[error("cannot write or read CalculiX's files: {0}")]
    Files(#[from] std::io::Error),
    /// It gave up.
    #[error("ccx failed ({status}): {said}")]
    Failed {
        /// How it ended.
        status: String,
        /// Its last lines.
        said: String,
    },
    /// Its results lack something.
    #[error("ccx has no {0} among its results")]
    Results(&'static str),
    /// The question cannot be.
    #[error(transparent)]
    Question(#[from] MechanicsError),
}

/// Whether `ccx` is on the path.
#[must_use]
pub fn available() -> bool {
    Command::new("ccx")
        .arg("-v")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok()
}

/// A model of one material under several loads, one after the other.
struct Model {
    /// \[m\]; x is the distance from the axis and y the height where the elements are axisymmetric.
    nodes: Vec<Point3<f64>>,
    /// As CalculiX calls it.
    element: &'static str,
    /// Nodes of each element, counted from 0, in CalculiX's order.
    elements: Vec<Vec<usize>>,
    young_modulus: f64,
    poisson_ratio: f64,
    /// Whether displacements are large: neo-Hookean rubber with these moduli where it is hardly stretched, each load after the one before.
    large: bool,
    /// Nodes and which of their displacements are none.
    held: Vec<(usize, [bool; 3])>,
    /// Elements whose points of integration are of interest.
    sensors: Vec<usize>,
    loads: Vec<Load>,
}

/// What acts on a model.
#[derive(Clone, Default)]
struct Load {
    /// Node and force \[N\].
    forces: Vec<(usize, Vector3<f64>)>,
    /// Element, face as CalculiX calls it, pressure \[Pa\].
    pressures: Vec<(usize, &'static str, f64)>,
}

/// Node, direction and force \[N\] of a component of a load that moves something.
type Move = (usize, usize, f64);

/// What a load makes of each node and each sensor.
struct Answer {
    /// \[m\].
    displacements: Vec<Vector3<f64>>,
    /// Mean compressive stress −σₖₖ/3 \[Pa\], extrapolated from the elements around the node and averaged.
    pressures: Vec<f64>,
    /// The same at the points of integration of each sensor's element, averaged over them.
    sensed: Vec<f64>,
}

impl Model {
    fn deck(&self) -> String {
        let mut s = String::from("*NODE\n");
        // Writing to a string cannot fail.
        for (i, p) in self.nodes.iter().enumerate() {
            let _ = writeln!(s, "{}, {:.12e}, {:.12e}, {:.12e}", i + 1, p.x, p.y, p.z);
        }
        let _ = writeln!(s, "*ELEMENT, TYPE={}, ELSET=BODY", self.element);
        for (i, nodes) in self.elements.iter().enumerate() {
            let _ = write!(s, "{}", i + 1);
            for (k, n) in nodes.iter().enumerate() {
                // At most 16 numbers a line.
                let _ = write!(s, ",{}{}", if k == 14 { "\n" } else { " " }, n + 1);
            }
            s.push('\n');
        }
        let (young, poisson) = (self.young_modulus, self.poisson_ratio);
        let law = if self.large {
            // C₁₀ is half of the shear modulus, D₁ two over the bulk modulus.
            let (c10, d1) = (young / 4.0 / (1.0 + poisson), 6.0 * (1.0 - 2.0 * poisson) / young);
            format!("*HYPERELASTIC, NEO HOOKE\n{c10:.12e}, {d1:.12e}")
        } else {
            format!("*ELASTIC\n{young}, {poisson}")
        };
        let _ = writeln!(
            s,
            "*MATERIAL, NAME=RUBBER\n{law}\n*SOLID SECTION, ELSET=BODY, MATERIAL=RUBBER\n*BOUNDARY"
        );
        if !self.sensors.is_empty() {
            s.insert_str(s.find("*MATERIAL").unwrap_or(0), &{
                let numbers: Vec<String> = self.sensors.iter().map(|e| format!("{},\n", e + 1)).collect();
                format!("*ELSET, ELSET=SENSORS\n{}", numbers.concat())
            });
        }
        for (n, held) in &self.held {
            for (k, _) in held.iter().enumerate().filter(|(_, held)| **held) {
                let _ = writeln!(s, "{}, {}", n + 1, k + 1);
            }
        }
        let moves = self.moves();
        match self.own_moves(&moves) {
            Some(own) => self.at_once(&moves, &own, &mut s),
            None => self.one_by_one(&moves, &mut s),
        }
        s
    }

    /// Of each load, the node and direction of the strongest of its forces where no other load acts, and that force. `None` where they are
    /// not several loads, or not of forces alone, or displacements are large, or one of them has no such force that is about as strong as its others.
    fn own_moves(&self, moves: &[Vec<Move>]) -> Option<Vec<Move>> {
        if self.large || self.loads.len() < 2 || self.loads.iter().any(|load| !load.pressures.is_empty()) {
            return None;
        }
        let mut acting = HashMap::new();
        for (n, k, _) in moves.iter().flatten() {
            *acting.entry((n, k)).or_insert(0) += 1;
        }
        let stronger = |a: &&Move, b: &&Move| a.2.abs().total_cmp(&b.2.abs());
        moves
            .iter()
            .map(|moves| {
                let all = moves.iter().max_by(stronger)?;
                let own = moves.iter().filter(|(n, k, _)| acting[&(n, k)] == 1).max_by(stronger)?;
                (own.2.abs() > 0.1 * all.2.abs()).then_some(*own)
            })
            .collect()
    }

    /// What moves something of each load.
    fn moves(&self) -> Vec<Vec<Move>> {
        let held: HashMap<usize, [bool; 3]> = self.held.iter().copied().collect();
        let moves = |(n, k, f): &Move| *f != 0.0 && !held.get(n).is_some_and(|held| held[*k]);
        let of = |load: &Load| -> Vec<Move> {
            let components =
                load.forces.iter().flat_map(|(n, force)| force.iter().enumerate().map(|(k, f)| (*n, k, *f)));
            components.filter(moves).collect()
        };
        self.loads.iter().map(of).collect()
    }

    /// All loads by one factorisation.
    ///
    /// CalculiX factors the matrix anew for every static step. Its Green functions share one factor, but each is of a force on one node in
    /// one direction. So each load gets a node whose displacement is the load's work, Σ f u, in place of one displacement in that sum:
    /// a unit force on it is the load.
    fn at_once(&self, moves: &[Vec<Move>], own: &[Move], s: &mut String) {
        let first = self.nodes.len() + 1;
        s.push_str("*NODE\n");
        for k in 0..own.len() {
            let _ = writeln!(s, "{}, 0, 0, 0", first + k);
        }
        for (k, (moves, (own_node, own_direction, f))) in moves.iter().zip(own).enumerate() {
            let others = || moves.iter().filter(|(n, d, _)| (n, d) != (own_node, own_direction));
            let _ = writeln!(s, "*EQUATION\n{}", 2 + others().count());
            let _ = writeln!(s, "{}, {}, {f:.12e}", own_node + 1, own_direction + 1);
            for (n, d, f) in others() {
                let _ = writeln!(s, "{}, {}, {f:.12e}", n + 1, d + 1);
            }
            let _ = writeln!(s, "{}, 1, -1", first + k);
        }
        s.push_str("*BOUNDARY\n");
        for k in 0..own.len() {
            let _ = writeln!(s, "{}, 2, 3", first + k);
        }
        s.push_str("*STEP\n*GREEN\n*CLOAD\n");
        for k in 0..own.len() {
            let _ = writeln!(s, "{}, 1, 1", first + k);
        }
        self.end_step(s);
    }

    fn one_by_one(&self, moves: &[Vec<Move>], s: &mut String) {
        for (load, moves) in self.loads.iter().zip(moves) {
            let step =
                if self.large { "*STEP, NLGEOM, INC=200\n*STATIC\n0.25, 1\n" } else { "*STEP\n*STATIC\n" };
            s.push_str(step);
            if !load.forces.is_empty() {
                s.push_str("*CLOAD, OP=NEW\n");
            }
            for (n, k, f) in moves {
                let _ = writeln!(s, "{}, {}, {f:.12e}", n + 1, k + 1);
            }
            if !load.pressures.is_empty() {
                s.push_str("*DLOAD, OP=NEW\n");
            }
            for (e, face, p) in &load.pressures {
                let _ = writeln!(s, "{}, {face}, {p:.12e}", e + 1);
            }
            self.end_step(s);
        }
    }

    fn end_step(&self, s: &mut String) {
        let flat = if self.element.starts_with("CAX") { ", OUTPUT=2D" } else { "" };
        // Of a load that is put on bit by bit, the end alone.
        let last = if self.large { ", FREQUENCY=1000" } else { "" };
        let _ = writeln!(s, "*NODE FILE{flat}{last}\nU\n*EL FILE{flat}{last}\nS");
        if !self.sensors.is_empty() {
            s.push_str("*EL PRINT, ELSET=SENSORS\nS\n");
        }
        s.push_str("*END STEP\n");
    }

    fn solve(&self) -> Result<Vec<Answer>, CalculixError> {
        let folder = Folder::new()?;
        std::fs::write(folder.0.join("model.inp"), self.deck())?;
        let run = Command::new("ccx")
            .args(["-i", "model"])
            .current_dir(&folder.0)
            .env("OMP_NUM_THREADS", "1")
            .stdin(Stdio::null())
            .output()
            .map_err(|e| match e.kind() {
                std::io::ErrorKind::NotFound => CalculixError::Missing,
                _ => e.into(),
            })?;
        let results = std::fs::read_to_string(folder.0.join("model.frd"));
        let said = String::from_utf8_lossy(&run.stdout);
        let (true, Ok(results)) = (run.status.success() && !said.contains("*ERROR"), results) else {
            let mut last: Vec<&str> = said.lines().filter(|l| !l.trim().is_empty()).rev().take(3).collect();
            last.reverse();
            return Err(CalculixError::Failed { status: run.status.to_string(), said: last.join(" / ") });
        };
        let mut answers = self.read(&results)?;
        if !self.sensors.is_empty() {
            self.sense(&std::fs::read_to_string(folder.0.join("model.dat"))?, &mut answers)?;
        }
        Ok(answers)
    }

    /// Reads the stresses in the sensors' elements: a table a load, a line a point of integration.
    fn sense(&self, text: &str, answers: &mut [Answer]) -> Result<(), CalculixError> {
        let missing = CalculixError::Results("stresses of every sensor");
        let mut tables = text.split("stresses (").skip(1);
        for answer in answers {
            let Some(table) = tables.next() else { return Err(missing) };
            let mut sums = vec![(0.0, 0u32); self.sensors.len()];
            for line in table.lines().skip(1) {
                let row: Vec<f64> = line.split_whitespace().map_while(|v| v.parse().ok()).collect();
                let [element, _, x, y, z, ..] = row[..] else { continue };
                for (sum, _) in
                    sums.iter_mut().zip(&self.sensors).filter(|(_, e)| (**e + 1) as f64 == element)
                {
                    sum.0 -= (x + y + z) / 3.0;
                    sum.1 += 1;
                }
            }
            if sums.iter().any(|(_, count)| *count == 0) {
                return Err(missing);
            }
            answer.sensed = sums.iter().map(|(sum, count)| sum / f64::from(*count)).collect();
        }
        Ok(())
    }

    /// Reads the results of every load out of a file in CalculiX's result format.
    fn read(&self, text: &str) -> Result<Vec<Answer>, CalculixError> {
        let mut answers = Vec::new();
        let mut displacements: Option<Vec<Vector3<f64>>> = None;
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            let Some(name) = line.strip_prefix(" -4  ") else { continue };
            let (moves, stress) = (name.starts_with("DISP"), name.starts_with("STRESS"));
            if !moves && !stress {
                continue;
            }
            let mut values = vec![[0.0; 3]; self.nodes.len()];
            for line in lines.by_ref() {
                if line.starts_with(" -3") {
                    break;
                }
                // A node in ten columns, numbers in twelve each, without spaces where they are negative.
                let Some(row) = line.strip_prefix(" -1") else { continue };
                let node = row.get(..10).and_then(|n| n.trim().parse::<usize>().ok());
                let number =
                    |k: usize| row.get(10 + 12 * k..22 + 12 * k).and_then(|v| v.trim().parse::<f64>().ok());
                let (Some(node), Some(a), Some(b), Some(c)) = (node, number(0), number(1), number(2)) else {
                    return Err(CalculixError::Results("number where one belongs"));
                };
                if let Some(value) = node.checked_sub(1).and_then(|n| values.get_mut(n)) {
                    *value = [a, b, c];
                }
            }
            if moves {
                displacements = Some(values.into_iter().map(Vector3::from).collect());
            } else {
                let displacements = displacements.take().ok_or(CalculixError::Results("displacements"))?;
                let pressures = values.into_iter().map(|s| -(s[0] + s[1] + s[2]) / 3.0).collect();
                answers.push(Answer { displacements, pressures, sensed: Vec::new() });
            }
        }
        if answers.len() == self.loads.len() {
            Ok(answers)
        } else {
            Err(CalculixError::Results("stresses of every load"))
        }
    }
}

/// A folder of its own for each run, removed with all that is in it.
struct Folder(PathBuf);

impl Folder {
    fn new() -> std::io::Result<Self> {
        use std::sync::atomic::{AtomicU32, Ordering};
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("dermis-ccx-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // What cannot be removed is left to whoever clears the folder for temporary files.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Reference of every case here.
const SOURCE: &str = "CalculiX ccx, run now";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Case;

    fn check(cases: Result<Vec<Case>, CalculixError>) {
        let cases = match cases {
            Err(CalculixError::Missing) => return println!("skipped: {}", CalculixError::Missing),
            cases => cases.unwrap(),
        };
        assert!(!cases.is_empty());
        for case in &cases {
            println!(
                "{} {}: {} for {} {} (within {:.2})",
                case.id, case.what, case.got, case.reference, case.unit, case.tolerance
            );
        }
        let wrong: Vec<&Case> = cases.iter().filter(|c| !c.pass).collect();
        assert!(wrong.is_empty(), "{wrong:#?}");
    }

    /// A strip that is held at one end, of 20-node hexahedra.
    fn strip(loads: Vec<Load>) -> Model {
        let planes = |cells: usize| (0..=cells).map(|i| i as f64 * 1e-3).collect::<Vec<_>>();
        let solid = quadratic::Quadratic::new(
            &crate::fem::HexMesh::block([&planes(6), &planes(3), &planes(1)]),
            |middle| middle,
        );
        let held = (0..solid.nodes.len()).filter(|&n| solid.nodes[n].x < 1e-9).map(|n| (n, [true; 3]));
        Model {
            held: held.collect(),
            nodes: solid.nodes,
            element: "C3D20R",
            elements: solid.cells,
            young_modulus: 1e6,
            poisson_ratio: 0.3,
            large: false,
            sensors: vec![4, 9],
            loads,
        }
    }

    #[test]
    fn loads_at_once_do_what_they_do_one_by_one() {
        let force = |n: usize, f: [f64; 3]| (n, Vector3::from(f));
        let load = |forces: Vec<(usize, Vector3<f64>)>| Load { forces, ..Load::default() };
        let loads = vec![
            load(vec![force(10, [0.1, 0.0, -0.2]), force(11, [0.0, 0.1, 0.3])]),
            load(vec![force(0, [5.0, 0.0, 0.0]), force(20, [0.0, -0.2, 0.1]), force(11, [0.0, 0.0, 0.1])]),
        ];
        let model = strip(loads.clone());
        assert!(model.nodes[0].x < 1e-9 && model.own_moves(&model.moves()).is_some());
        let at_once = match model.solve() {
            Err(CalculixError::Missing) => return println!("skipped: {}", CalculixError::Missing),
            answers => answers.unwrap(),
        };
        for (load, together) in loads.into_iter().zip(&at_once) {
            let alone = strip(vec![load]);
            assert!(alone.own_moves(&alone.moves()).is_none());
            let alone = alone.solve().unwrap().remove(0);
            let moves = |a: &Answer| a.displacements.iter().flat_map(|u| [u.x, u.y, u.z]).collect::<Vec<_>>();
            for (what, ours, theirs) in [
                ("displacements", moves(together), moves(&alone)),
                ("pressures", together.pressures.clone(), alone.pressures.clone()),
                ("sensed", together.sensed.clone(), alone.sensed.clone()),
            ] {
                let peak = theirs.iter().fold(0.0f64, |peak, v| peak.max(v.abs()));
                assert!(peak > 0.0 && ours.len() == theirs.len(), "{what}");
                for (a, b) in ours.iter().zip(&theirs) {
                    assert!((a - b).abs() < 2e-5 * peak, "{what}: {a} and {b} of {peak}");
                }
            }
        }
        // The same load twice has no force of its own.
        let twice = load(vec![force(10, [0.1, 0.0, 0.0])]);
        let same = strip(vec![twice.clone(), twice]);
        assert!(same.own_moves(&same.moves()).is_none());
    }

    #[test]
    fn layer_agrees() {
        check(layer_cases());
    }

    #[test]
    fn dome_agrees() {
        check(dome_cases());
    }

    #[test]
    fn block_agrees() {
        check(block_cases());
    }

    #[test]
    fn shell_agrees() {
        check(shell_cases());
    }
}
