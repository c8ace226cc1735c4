//! The cloud of force maps, and who asks the skins for them.

use dermis_msgs::msg::{ForceMap, SkinGeometry};

use super::*;
use crate::testing::square;

/// Waits for a number of subscribers.
fn until_heard_by(maps: &Publisher<ForceMap>, count: usize) {
    let deadline = Instant::now() + WAIT;
    while maps.subscriber_count() != count {
        assert!(Instant::now() < deadline, "{} subscribers and not {count}", maps.subscriber_count());
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// A skin computes no map that nobody listens to, so that the node must not subscribe one that goes nowhere.
#[test]
fn maps_are_subscribed_while_somebody_listens_to_their_cloud() {
    let mut bench = Bench::start(|c| c.assume_rest = true);
    let (_b, body) = bench.listen::<BodyContacts>("/body_contacts");
    let skin = bench.other.stream_publisher::<ContactArray>("/a/contacts", 10).unwrap();
    let maps = bench.other.stream_publisher::<ForceMap>("/a/force_map", 10).unwrap();
    let geometry = bench.other.publisher::<SkinGeometry>("/a/skin_geometry", Qos::latched()).unwrap();
    geometry.publish(&square::geometry("a_skin")).unwrap();
    // Its timer has run: it answers by itself.
    expect(&body, |_| true);
    assert_eq!((maps.subscriber_count(), geometry.subscriber_count()), (0, 0));

    let (listening, clouds) = bench.listen::<PointCloud2>("/force_points");
    until_heard_by(&maps, 1);
    let deadline = Instant::now() + WAIT;
    let found = loop {
        let stamp = bench.press(&skin);
        maps.publish(&square::map("a_skin", stamp, vec![0.05; 64])).unwrap();
        if let Some(found) = clouds.try_iter().find(|cloud| cloud.width == 64) {
            break found;
        }
        assert!(Instant::now() < deadline, "no cloud of the map came");
        std::thread::sleep(Duration::from_millis(5));
    };
    let force: f32 = square::points(&found).iter().map(|point| point[8]).sum();
    assert!((force + 3.2).abs() < 1e-4, "64 points of 0.05 N along the inward normal, not {force} N");

    drop(listening);
    until_heard_by(&maps, 0);
}
