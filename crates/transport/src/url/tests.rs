use proptest::prelude::*;

use super::*;

fn error(url: &str) -> String {
    SourceUrl::parse(url).unwrap_err().to_string()
}

#[test]
fn reads_every_scheme() {
    assert_eq!(
        SourceUrl::parse("serial:///dev/ttyACM0?baud=921600&parity=even&stop=2&idle=0.5").unwrap(),
        SourceUrl::Serial {
            path: "/dev/ttyACM0".into(),
            baud: 921_600,
            parity: Parity::Even,
            stop_bits: 2,
            idle: Some(Duration::from_millis(500)),
        }
    );
    assert_eq!(
        SourceUrl::parse("udp://[::]:7400?from=fe80::1").unwrap(),
        SourceUrl::Udp {
            bind: "[::]:7400".parse().unwrap(),
            from: Some("fe80::1".parse().unwrap()),
            sender: Sender::One,
            hold: HOLD,
            idle: None
        }
    );
    assert_eq!(
        SourceUrl::parse("udp://0.0.0.0:7400?sender=host&hold=0.25").unwrap(),
        SourceUrl::Udp {
            bind: "0.0.0.0:7400".parse().unwrap(),
            from: None,
            sender: Sender::Host,
            hold: Duration::from_millis(250),
            idle: None
        }
    );
    assert_eq!(
        SourceUrl::parse("tcp://skin.local:7400").unwrap(),
        SourceUrl::Tcp { address: "skin.local:7400".into(), idle: Some(IDLE) }
    );
    let listen = SourceUrl::TcpListen {
        bind: "0.0.0.0:7400".parse().unwrap(),
        newcomer: Newcomer::Refuse,
        hold: HOLD,
        idle: None,
    };
    assert_eq!(SourceUrl::parse("tcp-listen://0.0.0.0:7400").unwrap(), listen);
    assert_eq!(SourceUrl::parse("tcp://0.0.0.0:7400?listen").unwrap(), listen);
    for (text, address, path) in [
        ("http://cam.local", "cam.local:80", "/"),
        ("http://10.0.0.2:8080/?action=stream&n=1", "10.0.0.2:8080", "/?action=stream&n=1"),
        ("http://[fe80::1]?x", "[fe80::1]:80", "/?x"),
        ("http://[fe80::1]:81/a%20b", "[fe80::1]:81", "/a%20b"),
    ] {
        let url = SourceUrl::Http { address: address.into(), path: path.into() };
        assert_eq!(SourceUrl::parse(text).unwrap(), url);
        assert_eq!(SourceUrl::parse(&url.to_string()).unwrap(), url);
    }
    for wrong in
        ["http://", "http:///x", "http://me:secret@cam/", "http://cam:0/", "http://cam/a b", "http://cam/#x"]
    {
        assert!(SourceUrl::parse(wrong).is_err(), "{wrong}");
    }
    assert_eq!(SourceUrl::parse("pty://").unwrap(), SourceUrl::Pty { path: None, link: None });
    assert_eq!(
        SourceUrl::parse("replay:///data/my%20bag?speed=0&topic=/skin/taxels&skin=palm&loop=true").unwrap(),
        SourceUrl::Replay {
            path: "/data/my bag".into(),
            speed: 0.0,
            topic: Some("/skin/taxels".into()),
            skin: Some("palm".into()),
            repeat: true
        }
    );
    assert_eq!(
        SourceUrl::parse("replay://bags/first").unwrap(),
        SourceUrl::Replay { path: "bags/first".into(), speed: 1.0, topic: None, skin: None, repeat: false }
    );
}

#[test]
fn errors_name_the_part_and_what_is_valid() {
    insta::assert_snapshot!(error("/dev/ttyACM0"), @"source `/dev/ttyACM0` is not a URL: write it as SCHEME://…, where SCHEME is one of serial, udp, tcp, tcp-listen, http, v4l2, pty, replay");
    insta::assert_snapshot!(error("usb:///dev/ttyACM0"), @"source `usb:///dev/ttyACM0` has the unknown scheme `usb`; valid schemes are serial, udp, tcp, tcp-listen, http, v4l2, pty, replay");
    insta::assert_snapshot!(error("serial:///dev/ttyACM0?baudrate=9600"), @"source `serial:///dev/ttyACM0?baudrate=9600` has the unknown key `baudrate`; valid keys of serial:// are baud, parity, stop, idle");
    insta::assert_snapshot!(error("serial:///dev/ttyACM0?baud=fast"), @"source `serial:///dev/ttyACM0?baud=fast` has baud=fast, but baud must be a rate from 50 to 12000000");
    insta::assert_snapshot!(error("serial://?baud=9600"), @"source `serial://?baud=9600` has no usable path: expected a device file, as in serial:///dev/ttyACM0?baud=115200");
    insta::assert_snapshot!(error("udp://localhost"), @"source `udp://localhost` has no usable address: expected ADDRESS:PORT of this machine, as in 0.0.0.0:7400 or [::]:7400");
    insta::assert_snapshot!(error("tcp://host"), @"source `tcp://host` has no usable address: expected HOST:PORT, as in 192.168.1.20:7400");
    insta::assert_snapshot!(error("udp://0.0.0.0:7400?sender=two"), @"source `udp://0.0.0.0:7400?sender=two` has sender=two, but sender must be one, host or any");
    insta::assert_snapshot!(error("tcp://host:7400?newcomer=replace"), @"source `tcp://host:7400?newcomer=replace` has newcomer=replace, but newcomer must be left out without listen: here no client connects");
    insta::assert_snapshot!(error("tcp-listen://0.0.0.0:1?hold=0"), @"source `tcp-listen://0.0.0.0:1?hold=0` has hold=0, but hold must be seconds, 0.001 to 86400");
    insta::assert_snapshot!(error("replay://b?speed=-1"), @"source `replay://b?speed=-1` has speed=-1, but speed must be 0 (as fast as possible) or a positive factor");
    insta::assert_snapshot!(error("replay://b?speed=1&speed=2"), @"source `replay://b?speed=1&speed=2` gives the key `speed` twice");
}

fn any_url() -> impl Strategy<Value = SourceUrl> {
    let idle = || proptest::option::of((1u64..86_400_000).prop_map(Duration::from_millis));
    let hold = || (1u64..86_400_000).prop_map(Duration::from_millis);
    let path = || "/[a-z %?&=é]{1,12}".prop_map(PathBuf::from);
    let addr = || (any::<[u8; 4]>(), any::<u16>()).prop_map(|(ip, port)| SocketAddr::from((ip, port)));
    prop_oneof![
        (path(), 50u32..=12_000_000, 0u8..3, 1u8..=2, idle()).prop_map(|(path, baud, p, stop_bits, idle)| {
            let parity = [Parity::None, Parity::Even, Parity::Odd][usize::from(p)];
            SourceUrl::Serial { path, baud, parity, stop_bits, idle }
        }),
        (addr(), proptest::option::of(any::<[u8; 4]>()), 0u8..3, hold(), idle()).prop_map(
            |(bind, from, sender, hold, idle)| {
                let sender = [Sender::One, Sender::Host, Sender::Any][usize::from(sender)];
                SourceUrl::Udp { bind, from: from.map(IpAddr::from), sender, hold, idle }
            }
        ),
        ("[a-z]{1,8}", 1u16.., idle())
            .prop_map(|(host, port, idle)| SourceUrl::Tcp { address: format!("{host}:{port}"), idle }),
        (addr(), any::<bool>(), hold(), idle()).prop_map(|(bind, replace, hold, idle)| {
            let newcomer = if replace { Newcomer::Replace } else { Newcomer::Refuse };
            SourceUrl::TcpListen { bind, newcomer, hold, idle }
        }),
        (
            path(),
            proptest::option::of([1u32..=65_535, 1u32..=65_535]),
            proptest::option::of(1u32..=1000),
            idle()
        )
            .prop_map(|(path, size, rate, idle)| SourceUrl::Camera { path, size, rate, idle }),
        proptest::option::of(path()).prop_map(|path| SourceUrl::Pty { path, link: None }),
        path().prop_map(|link| SourceUrl::Pty { path: None, link: Some(link) }),
        (
            path(),
            0.0..100.0,
            proptest::option::of("/[a-z/]{1,9}"),
            proptest::option::of("[a-z_]{1,9}"),
            any::<bool>()
        )
            .prop_map(|(path, speed, topic, skin, repeat)| SourceUrl::Replay {
                path,
                speed,
                topic,
                skin,
                repeat
            }),
    ]
}

proptest! {
    #[test]
    fn display_reads_back(url in any_url()) {
        prop_assert_eq!(SourceUrl::parse(&url.to_string()).unwrap(), url);
    }

    #[test]
    fn never_panics(text in "(serial|udp|tcp|v4l2|pty|replay)?(://)?.{0,40}") {
        let _ = SourceUrl::parse(&text);
    }
}
