//! What a running skin feels: a table of its contacts.

use std::fmt::Write as _;

use dermis_msgs::msg::ContactArray;
use dermis_operate::{Touch, pressing_force};

/// \[s\] without a message after which the table says so.
const SILENT: f64 = 1.0;
/// \[m\] beyond which a contact is not in the plane z = 0, and the table has a column for z.
const FLAT: f64 = 1e-9;

/// Name, rate and latency, then the contacts, one a line.
#[must_use]
pub fn lines(touch: &Touch, elapsed: f64, now_ns: i64) -> Vec<String> {
    let (p50, p99) = (touch.latency_ms.percentile(50.0), touch.latency_ms.percentile(99.0));
    let mut lines = vec![format!(
        "{}  {elapsed:6.1} s  {:6.1} frames/s  latency {p50:.2} ms median, {p99:.2} ms p99",
        touch.name(),
        touch.recent_rate(),
    )];
    let Some(array) = &touch.latest else {
        lines.push("  waiting for the first frame".to_owned());
        return lines;
    };
    let silent = touch.silent(now_ns);
    if silent > SILENT {
        lines.push(format!("  nothing has come for {silent:.0} s"));
        return lines;
    }
    let flat = array.contacts.iter().all(|c| c.position.z.abs() <= FLAT);
    lines.push(row(flat, "track", ["x / mm", "y / mm", "z / mm", "F / N"].map(str::to_owned), "confidence"));
    for c in &array.contacts {
        let numbers = [c.position.x, c.position.y, c.position.z].map(|v| format!("{:.2}", v * 1e3));
        let [x, y, z] = numbers;
        let force = format!("{:.3}", pressing_force(c));
        lines.push(row(flat, &c.track_id.to_string(), [x, y, z, force], &format!("{:.2}", c.confidence)));
    }
    if array.contacts.is_empty() {
        let words = if array.status == ContactArray::STATUS_OK { "not touched" } else { &array.status_text };
        lines.push(format!("  {words}"));
    }
    lines
}

fn row(flat: bool, track: &str, [x, y, z, force]: [String; 4], confidence: &str) -> String {
    let mut line = format!("  {track:>5} {x:>9} {y:>9}");
    if !flat {
        // Writing to a text does not fail.
        let _ = write!(line, " {z:>9}");
    }
    let _ = write!(line, " {force:>9} {confidence:>11}");
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_msgs::builtin_interfaces::msg::Time;
    use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
    use dermis_msgs::msg::Contact;
    use dermis_msgs::std_msgs::msg::Header;

    const SECOND: i64 = 1_000_000_000;

    fn array(at_ns: i64, contacts: Vec<Contact>) -> ContactArray {
        let header = Header { stamp: Time::from_nanos(at_ns - 500_000), frame_id: "palm".to_owned() };
        ContactArray { header, skin: "palm".to_owned(), contacts, ..ContactArray::default() }
    }

    fn contact(position: [f64; 3], normal: [f64; 3], force: f64) -> Contact {
        let vector = |v: [f64; 3], by: f64| Vector3 { x: by * v[0], y: by * v[1], z: by * v[2] };
        let [x, y, z] = position;
        Contact {
            track_id: 8,
            position: Point { x, y, z },
            normal: vector(normal, 1.0),
            force: vector(normal, -force),
            confidence: 0.99,
            ..Contact::default()
        }
    }

    fn touch(contacts: &[Contact]) -> Touch {
        let mut touch = Touch::new("palm");
        for k in 0..=200 {
            touch.take(array(k * SECOND / 100, contacts.to_vec()), k * SECOND / 100);
        }
        touch
    }

    #[test]
    fn a_flat_skin_has_two_coordinates_and_a_curved_one_three() {
        let flat = touch(&[contact([1.2e-3, 9.18e-3, 0.0], [0.0, 0.0, 1.0], 0.301)]);
        insta::assert_snapshot!(lines(&flat, 12.1, 2 * SECOND).join("\n"), @r"
        palm    12.1 s   100.0 frames/s  latency 0.50 ms median, 0.50 ms p99
          track    x / mm    y / mm     F / N  confidence
              8      1.20      9.18     0.301        0.99
        ");
        let dome = touch(&[contact([6e-3, 0.0, 8e-3], [0.6, 0.0, 0.8], 1.5)]);
        insta::assert_snapshot!(lines(&dome, 12.1, 2 * SECOND).join("\n"), @r"
        palm    12.1 s   100.0 frames/s  latency 0.50 ms median, 0.50 ms p99
          track    x / mm    y / mm    z / mm     F / N  confidence
              8      6.00      0.00      8.00     1.500        0.99
        ");
    }

    #[test]
    fn a_skin_that_is_not_touched_and_one_that_cannot_tell_read_differently() {
        let words = |skin: &Touch, now| lines(skin, 1.0, now).pop().unwrap();
        assert_eq!(words(&Touch::new("palm"), 0), "  waiting for the first frame");
        let mut skin = touch(&[]);
        assert_eq!(words(&skin, 2 * SECOND), "  not touched");
        assert_eq!(words(&skin, 9 * SECOND), "  nothing has come for 7 s");
        let blind = ContactArray {
            status: ContactArray::STATUS_STALE,
            status_text: "no frame for 1.0 s".to_owned(),
            ..array(2 * SECOND, Vec::new())
        };
        skin.take(blind, 2 * SECOND);
        assert_eq!(words(&skin, 2 * SECOND), "  no frame for 1.0 s");
        assert_eq!((skin.arrays, skin.touched, skin.statuses), (202, 0, [201, 0, 1, 0, 0]));
    }
}
