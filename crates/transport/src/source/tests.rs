use std::io::Write as _;

use super::*;

#[test]
fn a_quick_consumer_gets_the_link_and_one_that_is_away_loses_it() {
    let mut device = crate::Pty::open().unwrap();
    let url = SourceUrl::parse(&format!("pty://{}", device.slave_path().display())).unwrap();
    let source = Source::open(url, SourceOptions::default());
    let handover = &source.reader.as_ref().unwrap().handover;
    let until = Instant::now() + Duration::from_secs(20);
    while !handover.is_free() {
        assert!(Instant::now() < until, "never handed over");
        device.write_all(b"more").unwrap();
        source.next_timeout(Duration::from_millis(100));
    }
    while handover.is_free() {
        assert!(Instant::now() < until, "never taken back");
        std::thread::sleep(MAX_UNREAD);
    }
}

#[test]
fn backoff_doubles_to_its_bound_and_starts_again() {
    let options =
        SourceOptions::default().with_backoff(Duration::from_millis(100), Duration::from_millis(500));
    let mut backoff = Backoff::new(&options);
    for nominal in [100, 200, 400, 500, 500] {
        let wait = backoff.next().as_secs_f64() * 1e3;
        let nominal = f64::from(nominal);
        assert!((0.79 * nominal..=1.21 * nominal).contains(&wait), "{wait} ms for {nominal} ms");
    }
    backoff.reset();
    assert!(backoff.next() <= Duration::from_millis(121));
}
