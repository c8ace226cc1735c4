//! A bag of before: read, copied, checked and converted.

#![expect(clippy::unwrap_used, reason = "a panic in a test is its failure report")]

use std::path::{Path, PathBuf};

use dermis_bag::{BagOptions, BagReader, BagWriter, Filter, Severity, check, convert, copy};
use dermis_msgs::msg::{Indentation, IndentationContact, SkinGeometry, TaxelFrame};
use dermis_msgs::{ChannelLayout, Message, TypeSupport, v0};

/// See its README.
fn before() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/v0/before")
}

const NAMES: [&str; 6] = ["b0", "b1", "b2", "b3", "b4", "b5"];

fn frames(bag: &BagReader) -> Vec<TaxelFrame> {
    bag.read::<TaxelFrame>("taxels").unwrap().map(|read| read.unwrap().message).collect()
}

/// NaN differs from itself, the bytes don't.
fn bytes<T: Message>(bag: &BagReader, topic: &str) -> Vec<Vec<u8>> {
    bag.read::<T>(topic).unwrap().map(|read| read.unwrap().message.to_cdr()).collect()
}

fn a_copy(out: &Path, topics: &[&str]) -> BagReader {
    let filter = Filter::default().topics(topics.iter().copied());
    copy(&BagReader::open(before()).unwrap(), out, filter, &BagOptions::default(), []).unwrap();
    BagReader::open(out).unwrap()
}

#[test]
fn messages_of_before_are_read_as_those_of_today() {
    let bag = BagReader::open(before()).unwrap();
    assert!(bag.topics().iter().all(dermis_bag::Topic::is_converted));
    let id = ChannelLayout::id_of("Pa", NAMES);
    let frames = frames(&bag);
    assert_eq!(frames.len(), 129);
    assert!(frames.iter().enumerate().all(|(i, frame)| {
        (frame.layout_id, frame.sequence, frame.values.len()) == (id, i as u64, 6)
            && frame.header.stamp.as_nanos() == 1_700_000_000_000_000_000 + i as i64 * 10_000_000
    }));
    // The values are those that were recorded.
    for (message, frame) in bag.messages_where(Filter::default().types([TaxelFrame::TYPE_NAME])).zip(&frames)
    {
        let message = message.unwrap();
        assert!(message.is_converted());
        let old = v0::msg::TaxelFrame::from_cdr(message.recorded()).unwrap();
        assert_eq!((old.channels, old.unit.as_str()), (NAMES.map(str::to_owned).to_vec(), "Pa"));
        assert_eq!((&old.values, &old.flags), (&frame.values, &frame.flags));
    }
    // A geometry of before does not say the unit: the frames do.
    let geometry = bag.read::<SkinGeometry>("skin_geometry").unwrap().next().unwrap().unwrap().message;
    assert_eq!((geometry.layout_id, geometry.unit.as_str()), (id, "Pa"));
    assert_eq!((&geometry.channels, geometry.points.len()), (&NAMES.map(str::to_owned).to_vec(), 132));

    let truths: Vec<Indentation> =
        bag.read("ground_truth").unwrap().map(|read| read.unwrap().message).collect();
    let contacts: Vec<&IndentationContact> = truths.iter().flat_map(|truth| &truth.contacts).collect();
    assert!(truths.iter().all(|truth| truth.gravity.z.is_nan()) && contacts.len() > 30);
    assert!(contacts.iter().all(|c| c.tip == IndentationContact::TIP_SPHERE && c.diameter == 0.004));

    let [skin] = bag.skins().unwrap().try_into().unwrap();
    let layout = ChannelLayout { unit: "Pa".into(), channels: NAMES.map(str::to_owned).to_vec() };
    assert_eq!((skin.name.as_str(), &skin.layouts), ("baro-line", &[(id, layout)].into()));
}

#[test]
fn a_check_says_of_which_version_it_is() {
    let report = check(before()).unwrap();
    assert!(report.is_sound() && report.missing_frames.is_empty(), "{report}");
    let notes: Vec<&str> = report.findings.iter().map(|finding| finding.problem.as_str()).collect();
    assert_eq!(notes.len(), 3, "{report}");
    assert!(report.findings.iter().all(|finding| finding.severity == Severity::Note));
    insta::assert_snapshot!(notes[0], @"/skin_geometry was recorded with dermis_msgs/msg/SkinGeometry as it was defined before: it is converted as it is read, `dermis bag convert` writes it anew");
}

#[test]
fn a_converted_bag_holds_the_same_in_the_definitions_of_today() {
    let dir = tempfile::tempdir().unwrap();
    let (old, out) = (BagReader::open(before()).unwrap(), dir.path().join("new"));
    let info = convert(&old, &out, &BagOptions::default()).unwrap();
    assert_eq!((info.messages, info.topics.len()), (259, 3));
    let new = BagReader::open(&out).unwrap();
    for (was, is) in old.topics().iter().zip(new.topics()) {
        assert_eq!((&was.name, was.messages, was.qos), (&is.name, is.messages, is.qos));
        let support = dermis_msgs::type_support(&is.type_name).unwrap();
        assert_eq!(is.type_hash.as_deref(), Some(support.hash));
        assert_eq!(is.definition.as_ref(), support.definition);
        assert!(!is.is_converted());
    }
    assert_eq!(bytes::<TaxelFrame>(&new, "taxels"), bytes::<TaxelFrame>(&old, "taxels"));
    assert_eq!(bytes::<Indentation>(&new, "ground_truth"), bytes::<Indentation>(&old, "ground_truth"));
    assert_eq!(bytes::<SkinGeometry>(&new, "skin_geometry"), bytes::<SkinGeometry>(&old, "skin_geometry"));
    assert_eq!(new.span(), old.span());
    assert_eq!(new.custom()["skin_hash"], old.custom()["skin_hash"]);
    insta::assert_snapshot!(new.custom()["converted from"], @"definitions of before, on /ground_truth, /skin_geometry, /taxels");
    let report = check(&out).unwrap();
    assert!(report.findings.is_empty(), "{report}");

    // Once more changes nothing but the folder.
    convert(&new, dir.path().join("again"), &BagOptions::default()).unwrap();
    let again = BagReader::open(dir.path().join("again")).unwrap();
    assert_eq!(again.custom()["converted from"], new.custom()["converted from"]);
    assert_eq!(again.info().messages, 259);
    let error = convert(&old, &out, &BagOptions::default()).unwrap_err().to_string();
    assert!(error.contains("exists already"), "{error}");
    assert_eq!(check(&out).unwrap().messages, 259);
}

#[test]
fn a_copy_stays_what_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let bag = a_copy(&dir.path().join("cut"), &["/taxels"]);
    let was = BagReader::open(before()).unwrap();
    assert_eq!(bag.topics()[0].type_hash, was.topic("taxels").unwrap().type_hash);
    assert!(bag.topics()[0].is_converted());
    assert_eq!(bytes::<TaxelFrame>(&bag, "taxels"), bytes::<TaxelFrame>(&was, "taxels"));
}

#[test]
fn frames_without_a_geometry_keep_their_names() {
    let dir = tempfile::tempdir().unwrap();
    let old = a_copy(&dir.path().join("cut"), &["/taxels"]);
    assert_eq!(old.skins().unwrap()[0].layouts.len(), 1, "the frames name their channels");
    let out = dir.path().join("new");
    convert(&old, &out, &BagOptions::default()).unwrap();
    let new = BagReader::open(&out).unwrap();
    let [geometry] =
        new.read::<SkinGeometry>("/skin_geometry").unwrap().collect::<Vec<_>>().try_into().unwrap();
    let geometry = geometry.unwrap();
    assert_eq!(Some(geometry.log_time), new.span().map(|(first, _)| first));
    let geometry = geometry.message;
    assert_eq!(ChannelLayout::of(&geometry).id(), frames(&new)[0].layout_id);
    assert_eq!((geometry.skin.as_str(), geometry.header.frame_id.as_str()), ("baro-line", "baro_line_link"));
    assert!(geometry.points.is_empty() && check(&out).unwrap().findings.is_empty());
}

#[test]
fn frames_that_nothing_names_are_noted() {
    let dir = tempfile::tempdir().unwrap();
    let converted = dir.path().join("new");
    convert(&BagReader::open(before()).unwrap(), &converted, &BagOptions::default()).unwrap();
    let new = BagReader::open(&converted).unwrap();
    let cut = dir.path().join("cut");
    copy(&new, &cut, Filter::default().topics(["/taxels"]), &BagOptions::default(), []).unwrap();
    let report = check(&cut).unwrap();
    assert!(report.is_sound());
    insta::assert_snapshot!(report.findings[0].problem, @"nothing here names the channels of the frames of skin `baro-line` on /taxels (layout 096a99b3): keep its skin description beside the bag, or record skin_geometry with it");
}

#[test]
fn damage_in_an_old_message_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag).unwrap();
    let old = TypeSupport::of::<v0::msg::TaxelFrame>();
    let good = v0::msg::TaxelFrame { skin: "pad".into(), ..Default::default() };
    writer.write_cdr("taxels", old, &good.to_cdr(), 1).unwrap();
    writer.write_cdr("taxels", old, &[0, 1, 0, 0, 9], 2).unwrap();
    writer.finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    let read: Vec<_> = reader.read::<TaxelFrame>("taxels").unwrap().collect();
    assert_eq!((read.len(), read[0].as_ref().unwrap().message.layout_id), (2, 0));
    let error = read[1].as_ref().unwrap_err().to_string();
    assert!(error.contains("does not decode as dermis_msgs/msg/TaxelFrame"), "{error}");
    let out = dir.path().join("out");
    assert!(convert(&reader, &out, &BagOptions::default()).is_err());
    assert!(!out.exists(), "nothing is left of it");
    assert!(!check(&bag).unwrap().is_sound());
}

/// A recorder that stores no hash: the definition tells.
#[test]
fn a_definition_without_a_hash_is_recognised() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag).unwrap();
    let old = TypeSupport::of::<v0::msg::TaxelFrame>();
    let respelled: &'static str = format!("# by another hand\n{}", old.definition).leak();
    let foreign = TypeSupport { hash: "", definition: respelled, ..*old };
    let frame = v0::msg::TaxelFrame {
        skin: "pad".into(),
        channels: vec!["a".into()],
        unit: "V".into(),
        values: vec![1.0],
        ..Default::default()
    };
    writer.write_cdr("taxels", &foreign, &frame.to_cdr(), 1).unwrap();
    writer.finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    assert_eq!(frames(&reader)[0].layout_id, ChannelLayout::id_of("V", ["a"]));
}
