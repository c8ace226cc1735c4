//! What foam remembers: hysteresis that does not depend on the rate, and creep.
//!
//! Both act on the pressure that the law of conduction sees. A pressed point that was never pressed before, and is held until creep
//! is over, sees the pressure itself: that is what the stateless response speaks of.
//!
//! - **Hysteresis** is a Prandtl–Ishlinskii model: play operators of several thresholds r. Each deviates by up to 2r from its path
//!   of first loading while the load falls; the mean share of that, 0 to 1, times `width` is what a point conducts as under more
//!   pressure. The deviation is in proportion to the pressure, so that a point that nothing presses conducts nothing.
//! - **Creep** is a Prony series: of each decade of time, a share of the pressure's effect arrives with its time constant. What has
//!   crept recovers in the same time after the load is gone.
//!
//! Points that nothing presses are not touched: what happened to them meanwhile is made up for when they are pressed again.
//! Cost: some tens of nanoseconds for each pressed point of a frame.

/// Thresholds of the plays, as shares of the reference pressure.
const PLAYS: [f64; 3] = [0.06, 0.2, 0.5];
/// \[s\] of the decades of creep.
const TIMES: [f64; 3] = [0.3, 3.0, 30.0];

/// How much a foam remembers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// Width of the loop, as a share of the pressure.
    pub hysteresis: f64,
    /// Share of the pressure's effect that each decade of time adds.
    pub creep: f64,
    /// \[Pa\].
    pub reference: f64,
}

impl Memory {
    /// Largest share that creep may have in each decade: three of them leave something at once.
    pub const MOST_CREEP: f64 = 0.3;

    /// Whether it remembers anything.
    #[must_use]
    pub fn remembers(&self) -> bool {
        self.hysteresis > 0.0 || self.creep > 0.0
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Point {
    plays: [f64; 3],
    crept: [f64; 3],
    /// \[s\] when it was last pressed.
    time: f64,
    /// Number of that frame, from 1.
    frame: u64,
}

/// Foam from when a device was switched on.
#[derive(Debug, Clone)]
pub struct Remembered {
    memory: Memory,
    points: Vec<Point>,
    frame: u64,
}

impl Remembered {
    /// Foam that was never pressed, with so many points.
    #[must_use]
    pub fn new(memory: Memory, points: usize) -> Self {
        Self { memory, points: vec![Point::default(); points], frame: 0 }
    }

    /// Changes the pressures \[Pa\] of points at `time` \[s\] into those that conduction sees. Every point is named once.
    pub fn apply(&mut self, time: f64, pressures: &mut [(usize, f64)]) {
        self.frame += 1;
        for (node, pressure) in pressures {
            let point = &mut self.points[*node];
            let held = point.frame != 0 && point.frame + 1 == self.frame;
            let dt = (time - point.time).max(0.0);
            *pressure = point.next(&self.memory, *pressure, held, dt);
            (point.time, point.frame) = (time, self.frame);
        }
    }
}

impl Point {
    /// The pressure that conduction sees; `held` where the point was pressed in the frame before, `dt` \[s\] ago.
    fn next(&mut self, memory: &Memory, pressure: f64, held: bool, dt: f64) -> f64 {
        let mut off = 0.0;
        for (play, share) in self.plays.iter_mut().zip(PLAYS) {
            let threshold = share * memory.reference;
            if !held {
                *play = play.clamp(-threshold, threshold);
            }
            *play = play.clamp(pressure - threshold, pressure + threshold);
            off += (*play - (pressure - threshold).max(0.0)) / (2.0 * threshold);
        }
        let hysteretic = pressure * (1.0 + memory.hysteresis * off.max(0.0) / PLAYS.len() as f64);
        let mut behind = 0.0;
        for (crept, time) in self.crept.iter_mut().zip(TIMES) {
            let left = (-dt / time).exp();
            *crept = if held { hysteretic + (*crept - hysteretic) * left } else { *crept * left };
            if hysteretic > 0.0 {
                behind += 1.0 - (*crept / hysteretic).min(1.0);
            }
        }
        hysteretic * (1.0 - memory.creep * behind)
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    const MEMORY: Memory = Memory { hysteresis: 0.15, creep: 0.02, reference: 5e4 };

    fn seen(foam: &mut Remembered, time: f64, pressure: f64) -> f64 {
        let mut pressures = [(0, pressure)];
        foam.apply(time, &mut pressures);
        pressures[0].1
    }

    #[test]
    fn first_loading_that_is_held_ends_at_the_pressure() {
        let mut foam = Remembered::new(MEMORY, 1);
        let at_once = seen(&mut foam, 0.0, 8e4);
        assert_relative_eq!(at_once, 8e4 * (1.0 - 3.0 * MEMORY.creep), max_relative = 1e-12);
        let later = seen(&mut foam, 3.0, 8e4);
        assert!(at_once < later && later < 8e4, "{later}");
        assert_relative_eq!(seen(&mut foam, 1e4, 8e4), 8e4, max_relative = 1e-9);
    }

    #[test]
    fn a_loop_is_as_wide_as_it_says() {
        let mut foam = Remembered::new(Memory { creep: 0.0, ..MEMORY }, 1);
        let mut time = 0.0;
        let mut ramp = |from: f64, to: f64| -> f64 {
            let mut last = 0.0;
            for i in 0..=100 {
                time += 0.01;
                last = seen(&mut foam, time, from + (to - from) * f64::from(i) / 100.0);
            }
            last
        };
        let up = ramp(0.0, 5e4);
        ramp(5e4, 1.2e5);
        // All plays have turned around after 2 · 0.5 · 50 kPa.
        let down = ramp(1.2e5, 5e4);
        assert_relative_eq!(up, 5e4, max_relative = 1e-12);
        assert_relative_eq!(down, 5e4 * (1.0 + MEMORY.hysteresis), max_relative = 1e-9);
        assert_eq!(ramp(5e4, 0.0), 0.0);
    }

    #[test]
    fn what_has_crept_recovers() {
        let mut foam = Remembered::new(Memory { hysteresis: 0.0, ..MEMORY }, 2);
        let fresh = seen(&mut foam, 0.0, 5e4);
        seen(&mut foam, 1000.0, 5e4);
        // Frames in which something else is pressed.
        foam.apply(1000.1, &mut [(1, 1e4)]);
        let soon = seen(&mut foam, 1000.2, 5e4);
        foam.apply(1000.3, &mut [(1, 1e4)]);
        let late = seen(&mut foam, 3000.0, 5e4);
        assert!(soon > fresh, "{soon} {fresh}");
        assert_relative_eq!(late, fresh, max_relative = 1e-9);
    }

    #[test]
    fn without_memory_nothing_changes() {
        let mut foam = Remembered::new(Memory { hysteresis: 0.0, creep: 0.0, reference: 5e4 }, 1);
        for (i, p) in [1.0, 3e4, 1e5, 2e4, 7.7].into_iter().enumerate() {
            assert_eq!(seen(&mut foam, i as f64, p).to_bits(), p.to_bits());
        }
    }
}
