//! A link that is foreign, silent, shared, or comes and goes.

use std::io::Write;

use dermis_node::Status;

use super::*;

#[test]
fn a_device_on_the_other_wire_receives_the_key() {
    let bench = Bench::new();
    let mut pty = Pty::open().unwrap();
    pty.link(bench.path("tty")).unwrap();
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let deadline = Instant::now() + WAIT;
    loop {
        assert!(Instant::now() < deadline, "{:?}", running.diagnosis());
        let _ = pty.write_lossy(b"101325.0,101320.5,101318.0,101330.0\r\n");
        match contacts.recv_timeout(Duration::from_millis(10)) {
            Ok(message) if message.status == ContactArray::STATUS_FAULT => {
                let key = "write `[wire]` and below it `protocol = \"ascii\"` into the skin file";
                assert!(message.status_text.contains(key), "{}", message.status_text);
                break;
            }
            _ => {}
        }
    }
    assert_eq!(running.diagnosis().level, Level::Error);
}

#[test]
fn an_unplugged_skin_is_stale_and_comes_back() {
    let bench = Bench::new();
    let device = Device::plug(&bench.path("tty"));
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    expect(&contacts, "untouched", untouched);
    drop(device);
    let stale = expect(&contacts, "stale", |m| m.status == ContactArray::STATUS_STALE);
    assert!(stale.contacts.is_empty());
    assert!(stale.status_text.starts_with("no frame for "), "{}", stale.status_text);
    assert_eq!(running.diagnosis().level, Level::Stale);
    expect(&contacts, "it keeps saying so", |m| m.status == ContactArray::STATUS_STALE);
    let device = Device::plug(&bench.path("tty"));
    expect(&contacts, "back", untouched);
    device.press([0.0, 3000.0, 0.0, 0.0]);
    expect(&contacts, "a contact", |m| m.contacts.first().is_some_and(|c| c.position.x > 0.0));
}

#[test]
fn a_second_sender_on_the_port_is_left_out_and_diagnosed() {
    let bench = Bench::new();
    let bind = || std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let to = bind().local_addr().unwrap();
    let mut config = bench.config();
    config.source = format!("udp://{to}?hold=5");
    let running = bench.start(&config);
    let stop = Arc::new(AtomicBool::new(false));
    let sender = || {
        let (socket, stop) = (bind(), Arc::clone(&stop));
        let own = socket.local_addr().unwrap();
        let thread = std::thread::spawn(move || {
            let mut encoder = NativeEncoder::new(NativeFormat::F32);
            for k in 0_u32.. {
                if stop.load(Ordering::Acquire) {
                    break;
                }
                let _ = socket.send_to(encoder.encode(k, 1, &[101_325.0 + (k % 40) as f32; 4]).unwrap(), to);
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        (own, thread)
    };
    let until = |what: &str, holds: &dyn Fn(&Status) -> bool| {
        let deadline = Instant::now() + WAIT;
        loop {
            let status = running.diagnosis();
            if holds(&status) {
                return status;
            }
            assert!(Instant::now() < deadline, "never came: {what}; {status:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    let value = |status: &Status, key: &str| {
        status.values.iter().find(|(k, _)| k == key).map_or(String::new(), |(_, value)| value.clone())
    };
    let (first, one) = sender();
    until("frames", &|s| value(s, "frames").parse::<u64>().is_ok_and(|n| n > 5));
    let (second, two) = sender();
    let sentence = format!("{second} wants to send too and is left out, while {first} is read");
    let status = until("the warning", &|s| s.message.contains(&sentence));
    assert!(status.level >= Level::Warn);
    assert_eq!(value(&status, "other senders"), second.to_string());
    assert_ne!(value(&status, "datagrams of others"), "0");
    stop.store(true, Ordering::Release);
    one.join().unwrap();
    two.join().unwrap();
    running.stop();
}

#[test]
fn a_foreign_device_is_a_fault_with_one_sentence() {
    let bench = Bench::new();
    let running = bench.start(&bench.config());
    let observer = bench.observer();
    let (_contacts, contacts) = listen::<ContactArray>(&observer, "contacts", Qos::sensor_data());
    let nothing = expect(&contacts, "no device yet", |m| m.status == ContactArray::STATUS_STALE);
    assert!(nothing.status_text.contains("tty"), "{}", nothing.status_text);

    let mut pty = Pty::open().unwrap();
    pty.link(bench.path("tty")).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let chatter = std::thread::spawn(move || {
        while !stopped.load(Ordering::Acquire) {
            let _ = pty.write_lossy(b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M\r\n");
            let _ = pty.flush();
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let fault = expect(&contacts, "a fault", |m| m.status == ContactArray::STATUS_FAULT);
    stop.store(true, Ordering::Release);
    chatter.join().unwrap();
    assert!(fault.contacts.is_empty());
    assert!(
        fault.status_text.starts_with("skin `pad` on pty://")
            && fault.status_text.contains("the device sends text"),
        "{}",
        fault.status_text
    );
    running.stop();
}
