//! The encoding: layout, both byte orders, every value there and back, and bytes of any kind.

use dermis_msgs::builtin_interfaces::msg::{Duration, Time};
use dermis_msgs::geometry_msgs::msg::{Point, Pose, Quaternion, Vector3, Wrench};
use dermis_msgs::msg::{
    BodyContact, BodyContacts, Contact, ContactArray, Indentation, IndentationContact, LinkWrench,
    SkinGeometry, SkinHealth, TaxelFrame,
};
use dermis_msgs::rcl_interfaces::msg::{FloatingPointRange, ParameterDescriptor, ParameterValue};
use dermis_msgs::rcl_interfaces::srv::DescribeParametersResponse;
use dermis_msgs::std_msgs::msg::{self as std_msg, Header};
use dermis_msgs::std_srvs::srv::TriggerRequest;
use dermis_msgs::{CdrErrorKind, Message, type_support, type_supports};
use proptest::collection::vec;
use proptest::prelude::*;

/// NaN and infinities, too: messages are compared by their bytes.
fn f64s() -> impl Strategy<Value = f64> {
    any::<f64>()
}

prop_compose! {
    fn headers()(nanos in any::<i64>(), frame in ".{0,9}") -> Header { Header::new(nanos, frame) }
}
prop_compose! {
    fn points()(x in f64s(), y in f64s(), z in f64s()) -> Point { Point { x, y, z } }
}
prop_compose! {
    fn vectors()(x in f64s(), y in f64s(), z in f64s()) -> Vector3 { Vector3 { x, y, z } }
}
prop_compose! {
    fn poses()(position in points(), x in f64s(), y in f64s(), z in f64s(), w in f64s()) -> Pose {
        Pose { position, orientation: Quaternion { x, y, z, w } }
    }
}
prop_compose! {
    fn contacts()(
        track_id in any::<u32>(), position in points(), normal in vectors(), force in vectors(),
        force_components in any::<u8>(), position_covariance in proptest::array::uniform9(f64s()),
        force_covariance in proptest::array::uniform9(f64s()), diameter in any::<f32>(), confidence in any::<f32>(),
        taxels in vec(any::<u32>(), 0..5),
    ) -> Contact {
        Contact {
            track_id, position, normal, force, force_components, position_covariance, force_covariance, diameter,
            confidence, taxels,
        }
    }
}
prop_compose! {
    fn contact_arrays()(
        header in headers(), skin in ".{0,9}", sequence in any::<u64>(), status in any::<u8>(),
        status_text in ".{0,30}", sensor_kind in any::<u8>(), force_threshold in any::<f32>(),
        force_max in any::<f32>(), contacts in vec(contacts(), 0..4),
    ) -> ContactArray {
        ContactArray {
            header, skin, sequence, status, status_text, sensor_kind, force_threshold, force_max, contacts,
        }
    }
}
prop_compose! {
    fn geometries()(
        header in headers(), skin in ".{0,9}", geometry_id in ".{0,9}", points in vec(points(), 0..5),
        normals in vec(vectors(), 0..5), areas in vec(any::<f32>(), 0..5), triangles in vec(any::<u32>(), 0..7),
        taxels in vec(".{0,9}", 0..5), taxel_poses in vec(poses(), 0..4), channels in vec(".{0,9}", 0..5),
        channel_taxels in vec(any::<u32>(), 0..5), layout_id in any::<u32>(), unit in ".{0,3}", electrodes in any::<u16>(),
    ) -> SkinGeometry {
        SkinGeometry {
            header, skin, geometry_id, skin_hash: "sha256:0".to_owned(), points, normals, areas, triangles, taxels,
            taxel_poses, layout_id, unit, channels, channel_taxels, electrodes,
        }
    }
}
prop_compose! {
    fn truths()(
        header in headers(), session in ".{0,9}", press in any::<u64>(), phase in any::<u8>(), gravity in vectors(),
        contacts in vec((points(), vectors(), vec(f64s(), 0..4), poses(), ".{0,9}", any::<f32>()), 0..3),
    ) -> Indentation {
        let contacts = contacts.into_iter().map(|(position, normal, tip_parameters, tip_pose, tip_name, temperature)| {
            IndentationContact {
                position, normal, tip: IndentationContact::TIP_BOX, tip_parameters, tip_name, tip_pose, temperature,
                ..IndentationContact::default()
            }
        });
        Indentation { header, session, press, phase, gravity, contacts: contacts.collect(), ..Indentation::default() }
    }
}
prop_compose! {
    fn body_contacts()(
        contact in contacts(), link in ".{0,9}", other_links in vec(".{0,9}", 0..3), skins in vec(".{0,9}", 0..3),
        skin_tracks in vec(any::<u32>(), 0..3), body_from_contact in poses(), velocity in vectors(),
        velocity_covariance in proptest::array::uniform9(f64s()), nanos in any::<i64>(), slip in any::<u8>(),
        slip_confidence in any::<f32>(), cause in any::<u8>(),
    ) -> BodyContact {
        BodyContact {
            contact, link, other_links, skins, skin_tracks, body_from_contact, velocity, velocity_covariance,
            stamp: Time::from_nanos(nanos), age: Duration::from_nanos(nanos / 3), slip, slip_confidence, cause,
        }
    }
}
prop_compose! {
    fn bodies()(
        header in headers(), status in any::<u8>(), status_text in ".{0,30}", contacts in vec(body_contacts(), 0..3),
        skins in vec((".{0,9}", any::<f32>(), any::<u64>()), 0..3), wrench in (vectors(), vectors()),
        links in vec(".{0,9}", 0..3), joints in vec((".{0,9}", f64s(), f64s()), 0..3),
    ) -> BodyContacts {
        let (force, torque) = wrench;
        let net_wrench = Wrench { force, torque };
        BodyContacts {
            header, sequence: 9, status, status_text,
            skins: skins.into_iter().map(|(skin, rate, lost)| SkinHealth { skin, rate, lost, ..SkinHealth::default() }).collect(),
            contacts,
            wrenches: links.into_iter()
                .map(|link| LinkWrench { link, body_wrench: net_wrench.clone(), ..LinkWrench::default() })
                .collect(),
            joints: joints.iter().map(|joint| joint.0.clone()).collect(),
            joint_torques: joints.iter().map(|joint| joint.1).collect(),
            unexplained_torques: joints.iter().map(|joint| joint.2).collect(),
            unexplained_variances: Vec::new(),
            net_wrench,
        }
    }
}
prop_compose! {
    fn descriptions()(
        descriptors in vec((".{0,9}", any::<u8>(), any::<bool>(), proptest::option::of((f64s(), f64s(), f64s()))), 0..4),
    ) -> DescribeParametersResponse {
        let descriptors = descriptors.into_iter().map(|(name, r#type, read_only, range)| ParameterDescriptor {
            name, r#type, read_only,
            floating_point_range: range.into_iter()
                .map(|(from_value, to_value, step)| FloatingPointRange { from_value, to_value, step })
                .collect(),
            ..ParameterDescriptor::default()
        });
        DescribeParametersResponse { descriptors: descriptors.collect() }
    }
}

#[expect(clippy::unwrap_used, reason = "a panic is the failure report")]
fn round_trips<T: Message>(message: &T) {
    let bytes = message.to_cdr();
    let decoded = T::from_cdr(&bytes).unwrap();
    assert_eq!(decoded.to_cdr(), bytes);
    // Debug text holds every field, and NaN equals NaN in it.
    assert_eq!(format!("{decoded:?}"), format!("{message:?}"));
    for padding in [1, 2, 3, bytes.len() - 1] {
        assert!(T::from_cdr(&[&bytes[..], &vec![7; padding]].concat()).is_ok());
    }
    assert!(T::from_cdr(&[&bytes[..], &bytes[..]].concat()).is_err());
    for length in 0..bytes.len() {
        assert!(T::from_cdr(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn contact_arrays_round_trip(message in contact_arrays()) {
        round_trips(&message);
    }

    #[test]
    fn geometries_round_trip(message in geometries()) {
        round_trips(&message);
    }

    #[test]
    fn ground_truth_round_trips(message in truths()) {
        round_trips(&message);
    }

    #[test]
    fn bodies_round_trip(message in bodies()) {
        round_trips(&message);
    }

    #[test]
    fn parameter_descriptions_round_trip(message in descriptions()) {
        round_trips(&message);
    }

    #[test]
    fn json_gives_the_same_message_back(message in contact_arrays()) {
        let support = type_support(ContactArray::TYPE_NAME).unwrap();
        let json = (support.cdr_to_json)(&message.to_cdr()).unwrap();
        // Through text, as the bridge sends it.
        let text = serde_json::to_string(&json).unwrap();
        let again = (support.json_to_cdr)(&serde_json::from_str(&text).unwrap()).unwrap();
        prop_assert_eq!((support.cdr_to_json)(&again).unwrap(), json);
    }

    #[test]
    fn any_bytes_are_decoded_or_refused(bytes in vec(any::<u8>(), 0..400), little_endian: bool) {
        let bytes = [&[0, u8::from(little_endian), 0, 0], &bytes[..]].concat();
        for support in type_supports() {
            if let Ok(json) = (support.cdr_to_json)(&bytes) {
                prop_assert!(json.is_object());
            }
        }
    }

    #[test]
    fn damaged_messages_are_decoded_or_refused(
        message in contact_arrays(),
        damage in vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = message.to_cdr();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(decoded) = ContactArray::from_cdr(&bytes) {
            round_trips(&decoded);
        }
    }
}

#[test]
fn every_default_round_trips() {
    for support in type_supports() {
        let bytes = (support.json_to_cdr)(&serde_json::json!({})).unwrap();
        let json = (support.cdr_to_json)(&bytes).unwrap();
        assert_eq!((support.json_to_cdr)(&json).unwrap(), bytes, "{}", support.name);
    }
}

/// A frame whose every kind of field is at an odd place, by hand.
#[test]
fn layout_of_both_byte_orders() {
    let frame = TaxelFrame {
        header: Header::new(-1, "ab"),
        skin: String::new(),
        sequence: 2,
        device_time_us: 3,
        layout_id: 0x0403_0201,
        values: vec![1.0, -2.0],
        flags: vec![4],
        temperature: 0.5,
    };
    #[rustfmt::skip]
    let little: &[u8] = &[
        0, 1, 0, 0,
        0xff, 0xff, 0xff, 0xff, // sec
        0xff, 0xc9, 0x9a, 0x3b, // nanosec
        3, 0, 0, 0, b'a', b'b', 0, // frame_id
        0, 1, 0, 0, 0, 0, // skin
        0, 0, 0, // up to 24 for a uint64
        2, 0, 0, 0, 0, 0, 0, 0,
        3, 0, 0, 0, 0, 0, 0, 0,
        1, 2, 3, 4, // layout_id
        2, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0, // values
        1, 0, 0, 0, 4, // flags
        0, 0, 0, // up to 4 for a float32
        0, 0, 0, 0x3f, // temperature
    ];
    #[rustfmt::skip]
    let big: &[u8] = &[
        0, 0, 0, 0,
        0xff, 0xff, 0xff, 0xff,
        0x3b, 0x9a, 0xc9, 0xff,
        0, 0, 0, 3, b'a', b'b', 0,
        0, 0, 0, 0, 1, 0,
        0, 0, 0,
        0, 0, 0, 0, 0, 0, 0, 2,
        0, 0, 0, 0, 0, 0, 0, 3,
        4, 3, 2, 1,
        0, 0, 0, 2, 0x3f, 0x80, 0, 0, 0xc0, 0, 0, 0,
        0, 0, 0, 1, 4,
        0, 0, 0,
        0x3f, 0, 0, 0,
    ];
    assert_eq!(frame.to_cdr(), little);
    assert_eq!(TaxelFrame::from_cdr(little).unwrap(), frame);
    assert_eq!(TaxelFrame::from_cdr(big).unwrap(), frame);
}

#[test]
fn a_frame_costs_its_values() {
    let channels = 784;
    let frame = TaxelFrame {
        header: Header::new(1, "torso_link"),
        skin: "torso".to_owned(),
        values: vec![1.0; channels],
        flags: vec![0; channels],
        ..TaxelFrame::default()
    };
    assert!(frame.to_cdr().len() < channels * (4 + 1) + 100);
}

#[test]
fn a_buffer_is_used_again() {
    let mut buffer = vec![7; 1000];
    let capacity = buffer.capacity();
    let message = std_msg::String { data: "palm".to_owned() };
    message.to_cdr_in(&mut buffer);
    assert_eq!(buffer, message.to_cdr());
    assert_eq!(buffer.capacity(), capacity);
}

#[test]
fn messages_without_fields_have_one_byte() {
    assert_eq!(TriggerRequest {}.to_cdr(), [0, 1, 0, 0, 0]);
    // Peers that know nothing of rosidl's placeholder send the header only.
    assert!(TriggerRequest::from_cdr(&[0, 1, 0, 0]).is_ok());
    assert!(TriggerRequest::from_cdr(&[]).is_err());
}

#[test]
fn strings_of_peers() {
    let decode = |bytes: &[u8]| std_msg::String::from_cdr(&[&[0, 1, 0, 0], bytes].concat()).map(|m| m.data);
    assert_eq!(decode(&[0, 0, 0, 0]).unwrap(), "", "an empty string without its NUL");
    assert_eq!(decode(&[2, 0, 0, 0, b'a', b'b']).unwrap(), "ab", "a string without its NUL");
    assert_eq!(decode(&[4, 0, 0, 0, b'a', 0, b'b', 0]).unwrap(), "a\0b", "a NUL within");
    let with_nul = std_msg::String { data: "a\0b".to_owned() };
    assert_eq!(std_msg::String::from_cdr(&with_nul.to_cdr()).unwrap(), with_nul);
}

#[test]
fn defaults_of_the_text() {
    assert_eq!(Quaternion::default(), Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    assert!(!ParameterDescriptor::default().read_only);
}

/// What a person reads in a log.
#[test]
fn errors_say_what_is_wrong_and_where() {
    let bytes = ContactArray { contacts: vec![Contact::default()], ..ContactArray::default() }.to_cdr();
    let refuse = |bytes: &[u8]| ContactArray::from_cdr(bytes).unwrap_err().to_string();

    insta::assert_snapshot!(refuse(&[1]), @"not a dermis_msgs/msg/ContactArray: 1 bytes hold no encapsulation header, which has 4");
    insta::assert_snapshot!(refuse(&[0, 3, 0, 0, 0]), @"not a dermis_msgs/msg/ContactArray: encapsulation 00 03 is neither big-endian (00 00) nor little-endian (00 01) plain CDR");
    insta::assert_snapshot!(refuse(&bytes[..bytes.len() - 9]), @"not a dermis_msgs/msg/ContactArray: Contact.diameter at byte 292 needs 4 bytes, 3 are left");
    insta::assert_snapshot!(refuse(&[&bytes[..], &bytes[..]].concat()), @"not a dermis_msgs/msg/ContactArray: 304 bytes follow the message, which ends at byte 304: this is another type or another version");

    let mut far = bytes.clone();
    far[12..16].fill(0xff);
    insta::assert_snapshot!(refuse(&far), @"not a dermis_msgs/msg/ContactArray: Header.frame_id at byte 12 claims a length of 4294967295, at most 288 is possible");

    let mut text = bytes;
    text[16] = 0xc3;
    insta::assert_snapshot!(refuse(&text), @"not a dermis_msgs/msg/ContactArray: Header.frame_id at byte 16 is not UTF-8");

    let mut value = ParameterValue::default().to_cdr();
    value[5] = 9;
    insta::assert_snapshot!(ParameterValue::from_cdr(&value).unwrap_err(), @"not a rcl_interfaces/msg/ParameterValue: ParameterValue.bool_value at byte 5 is 9, a boolean is 0 or 1");

    let range = FloatingPointRange::default();
    let two = ParameterDescriptor { floating_point_range: vec![range.clone(), range], ..Default::default() };
    insta::assert_snapshot!(ParameterDescriptor::from_cdr(&two.to_cdr()).unwrap_err(), @"not a rcl_interfaces/msg/ParameterDescriptor: ParameterDescriptor.floating_point_range at byte 28 claims a length of 2, at most 1 is possible");
}

#[test]
fn nan_is_null_in_json_both_ways() {
    let support = type_support("dermis_msgs/msg/ContactArray").unwrap();
    let mut contact = Contact { confidence: f32::NAN, ..Contact::default() };
    contact.position.x = f64::NAN;
    contact.force_covariance[8] = f64::NAN;
    let bytes = ContactArray { contacts: vec![contact], ..ContactArray::default() }.to_cdr();
    let json = (support.cdr_to_json)(&bytes).unwrap();
    let contact = &json["contacts"][0];
    assert!(contact["confidence"].is_null() && contact["position"]["x"].is_null());
    assert!(contact["force_covariance"][8].is_null() && contact["force_covariance"][7] == 0.0);
    assert_eq!((support.json_to_cdr)(&json).unwrap(), bytes);

    let frame = TaxelFrame { values: vec![f32::NAN, 1.5], ..TaxelFrame::default() };
    let support = type_support(TaxelFrame::TYPE_NAME).unwrap();
    let json = (support.cdr_to_json)(&frame.to_cdr()).unwrap();
    assert_eq!(json["values"], serde_json::json!([null, 1.5]));
    assert_eq!((support.json_to_cdr)(&json).unwrap(), frame.to_cdr());
}

#[test]
fn json_that_does_not_fit_is_named() {
    let refuse = |json: serde_json::Value| {
        let error = (type_support("dermis_msgs/msg/ContactArray").unwrap().json_to_cdr)(&json).unwrap_err();
        assert!(matches!(error.kind, CdrErrorKind::Json { .. }));
        error.to_string()
    };
    insta::assert_snapshot!(refuse(serde_json::json!({"contacts": [{}, {"force": {"z": "hard"}}]})), @r#"not a dermis_msgs/msg/ContactArray: contacts[1].force.z: invalid type: string "hard", expected f64"#);
    insta::assert_snapshot!(refuse(serde_json::json!({"contacts": [{"force_covariance": [1, 2]}]})), @"not a dermis_msgs/msg/ContactArray: contacts[0].force_covariance: invalid length 2, expected 9 numbers");
    insta::assert_snapshot!(refuse(serde_json::json!({"header": {"frame": "palm"}})), @"not a dermis_msgs/msg/ContactArray: header.frame: unknown field `frame`, expected `stamp` or `frame_id`");
    insta::assert_snapshot!(refuse(serde_json::json!([1])), @"not a dermis_msgs/msg/ContactArray: [0]: invalid type: integer `1`, expected struct Header");
}

#[test]
fn types_are_found_by_name() {
    for support in type_supports() {
        assert!(std::ptr::eq(type_support(support.name).unwrap(), support));
    }
    assert!(type_support("dermis_msgs/msg/Nothing").is_none());
    let service = dermis_msgs::service_support("std_srvs/srv/Trigger").unwrap();
    assert_eq!(service.response.name, "std_srvs/srv/Trigger_Response");
}

#[test]
fn definitions_hold_every_type_once() {
    let separator = format!("{}\n", "=".repeat(80));
    let sections: Vec<&str> = ContactArray::DEFINITION.split(separator.as_str()).collect();
    assert!(sections[0].contains("\nstd_msgs/Header header\n"));
    let names: Vec<&str> = sections[1..].iter().filter_map(|section| section.lines().next()).collect();
    assert_eq!(
        names,
        [
            "MSG: builtin_interfaces/Time",
            "MSG: dermis_msgs/Contact",
            "MSG: geometry_msgs/Point",
            "MSG: geometry_msgs/Vector3",
            "MSG: std_msgs/Header"
        ]
    );
    assert!(sections[2].contains("\nuint32[] taxels"));
}
