use dermis_msgs::builtin_interfaces::msg::Time;
use dermis_msgs::geometry_msgs::msg::Vector3;
use dermis_msgs::msg::SkinHealth;

use super::*;

const HEAD: &str = "schema = 'dermis-reflex/1'\nname = 'test'\n\
    [inputs.body]\nkind = 'body'\ntopic = 'body_contacts'\ntimeout = 0.05\n\
    [inputs.palm]\nkind = 'skin'\ntopic = 'palm/contacts'\nskin = 'palm'\nlink = 'hand'\ntimeout = 0.05\n\
    [regions.hand]\nlinks = ['hand']\n[regions.named]\nskins = ['palm']\n\
    [limits.person]\nquasi_static = { force = 10.0, pressure = 20.0 }\ntransient = { force = 20.0, pressure = 40.0 }\n\
    time_to_quasi_static = 0.5\n\
    [actions.stop]\nkind = 'bool'\ntopic = 'stop'\n[[rules]]\nname = 'r'\nactions = ['stop']\n";

/// The rules of a file with this one rule.
fn rules(rule: &str) -> Rules {
    let other = "[[rules]]\nname = 'other'\nactions = ['stop']\n";
    Rules::from_toml(&format!("{HEAD}{rule}\n{other}"), "test.toml").unwrap_or_else(|e| panic!("{e}"))
}

const BODY: usize = 0;
const PALM: usize = 1;

fn pressed(force: f64) -> Contact {
    Contact {
        track_id: 1,
        normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
        force: Vector3 { x: 0.0, y: 0.0, z: -force },
        force_components: Contact::FORCE_NORMAL,
        diameter: 0.01,
        confidence: 0.9,
        ..Contact::default()
    }
}

fn palm(contacts: Vec<Contact>) -> ContactArray {
    ContactArray {
        skin: "palm".into(),
        sequence: 1,
        force_max: f32::NAN,
        contacts,
        ..ContactArray::default()
    }
}

fn on_skin(rule: &str, message: &ContactArray) -> Assessment {
    let rules = rules(rule);
    skin(&rules, &rules.rules[0], PALM, message, &vec![0.0; message.contacts.len()])
}

fn health(name: &str, link: &str, status: u8) -> SkinHealth {
    let stamp = Time { sec: 5, nanosec: 0 };
    SkinHealth { skin: name.into(), link: link.into(), status, stamp, ..SkinHealth::default() }
}

/// A hand and a foot, both well, with one contact on a link.
fn robot(link: &str, force: f64) -> BodyContacts {
    let contact = BodyContact {
        contact: pressed(force),
        link: link.into(),
        skins: vec![if link == "hand" { "palm".into() } else { "sole".into() }],
        ..BodyContact::default()
    };
    BodyContacts {
        sequence: 1,
        skins: vec![health("palm", "hand", 0), health("sole", "foot", 0)],
        contacts: vec![contact],
        ..BodyContacts::default()
    }
}

fn on_body(rule: &str, message: &BodyContacts) -> Assessment {
    let rules = rules(rule);
    body(&rules, &rules.rules[0], message)
}

#[test]
fn an_empty_list_of_a_skin_that_feels_is_no_touch() {
    assert_eq!(on_skin("force = { above = 5.0 }", &palm(vec![])), Assessment::default());
    let mut message = robot("hand", 0.0);
    message.contacts.clear();
    assert_eq!(on_body("force = { above = 5.0 }", &message), Assessment::default());
}

#[test]
fn a_force_is_compared_with_hysteresis() {
    let of = |force: f64| {
        let found =
            on_skin("force = { above = 5.0, release = 4.0 }", &palm(vec![pressed(1.0), pressed(force)]));
        (found.touched, found.touch.is_some(), found.holds)
    };
    assert_eq!(of(3.9), (true, false, false));
    assert_eq!(of(4.5), (true, false, true));
    assert_eq!(of(5.0), (true, false, true), "not above");
    assert_eq!(of(5.1), (true, true, true));
    assert_eq!(of(f64::INFINITY), (true, true, true));
}

#[test]
fn what_is_not_measured_counts_where_the_rule_says_so() {
    let mut unknown = pressed(0.0);
    unknown.force_components = Contact::FORCE_NONE;
    let nan = pressed(f64::NAN);
    for contact in [unknown, nan] {
        let found = on_skin("force = { above = 5.0 }", &palm(vec![contact.clone()]));
        assert_eq!(found.touch.as_deref(), Some("a contact on link `hand` has no force"));
        let found = on_skin("force = { above = 5.0 }\ncounts_as_touched = ['late']", &palm(vec![contact]));
        assert!(found.touch.is_none() && !found.holds);
    }
    for (rule, what) in [
        ("pressure = { above = 5.0 }", "pressure"),
        ("slip = 'gross'", "slip"),
        ("limits = 'person'", "pressure"),
    ] {
        let mut contact = pressed(0.1);
        contact.diameter = f32::NAN;
        let found = on_skin(rule, &palm(vec![contact]));
        assert_eq!(found.touch.unwrap(), format!("a contact on link `hand` has no {what}"));
    }
    let rules = rules("speed = { above = 0.1 }");
    let found = skin(&rules, &rules.rules[0], PALM, &palm(vec![pressed(1.0)]), &[f64::NAN]);
    assert_eq!(found.touch.unwrap(), "a contact on link `hand` has no sliding speed");
}

#[test]
fn a_pressure_is_the_largest_of_the_contact() {
    // 10 N over a disc of 10 mm: 12.73 N/cm² on average, 19.1 at the centre of a sphere's contact.
    let message = palm(vec![pressed(10.0)]);
    assert!(on_skin("pressure = { above = 19.0 }", &message).touch.is_some());
    assert!(on_skin("pressure = { above = 19.2 }", &message).touch.is_none());
    let found = on_skin("pressure = { above = 12.7 }\npeak_over_mean = 1.0", &message);
    assert_eq!(found.touch.unwrap(), "a pressure of 12.732 N/cm² on link `hand` is above 12.7 N/cm²");
    assert!(on_skin("pressure = { above = 12.8 }\npeak_over_mean = 1.0", &message).touch.is_none());
}

#[test]
fn standard_deviations_are_added() {
    let mut contact = pressed(4.0);
    contact.force_covariance[8] = 0.25;
    let message = palm(vec![contact.clone()]);
    assert!(on_skin("force = { above = 5.0 }\nsigmas = 1.9", &message).touch.is_none());
    assert!(on_skin("force = { above = 5.0 }\nsigmas = 2.1", &message).touch.is_some());
    contact.force_covariance = [f64::NAN; 9];
    let unknown = palm(vec![contact]);
    assert!(
        on_skin("force = { above = 5.0 }\nsigmas = 2.0", &unknown).touch.unwrap().contains("has no force")
    );
    assert!(on_skin("force = { above = 5.0 }", &unknown).touch.is_none(), "nobody asks for the covariance");
}

#[test]
fn limits_tell_short_contacts_from_lasting_ones() {
    let of = |force: f64| {
        let found = on_skin("limits = 'person'\npeak_over_mean = 1.0", &palm(vec![pressed(force)]));
        (found.touch.is_some(), found.lasting.is_some(), found.holds)
    };
    assert_eq!(of(8.9), (false, false, false));
    assert_eq!(of(9.5), (false, false, true), "above nine tenths of the quasi-static limit");
    assert_eq!(of(12.0), (false, true, true));
    assert_eq!(of(21.0), (true, true, true));
    // 16 N over 10 mm are 20.4 N/cm², 32 N 40.7.
    let mut wide = pressed(15.0);
    wide.diameter = 0.02;
    let found = on_skin("limits = 'person'\npeak_over_mean = 1.0", &palm(vec![wide]));
    assert_eq!(
        found.lasting.unwrap(),
        "a lasting force of 15 N on link `hand` is above 10 N, the quasi-static limit of `person`"
    );
    let mut sharp = pressed(9.0);
    sharp.diameter = 0.005;
    let found = on_skin("limits = 'person'\npeak_over_mean = 1.0", &palm(vec![sharp]));
    assert_eq!(
        found.touch.unwrap(),
        "a pressure of 45.837 N/cm² on link `hand` is above 40 N/cm², the transient limit of `person`"
    );
}

#[test]
fn each_status_is_its_loss() {
    for (status, text) in [
        (ContactArray::STATUS_DEGRADED, None),
        (ContactArray::STATUS_STALE, Some("skin `palm` is stale: why")),
        (ContactArray::STATUS_UNCALIBRATED, Some("skin `palm` is uncalibrated: why")),
        (ContactArray::STATUS_FAULT, Some("skin `palm` is at fault: why")),
        (77, Some("skin `palm` is at fault: why")),
    ] {
        let message = ContactArray { status, status_text: "why".into(), ..palm(vec![]) };
        let found = on_skin("force = { above = 5.0 }", &message);
        assert_eq!((found.loss.as_deref(), found.holds), (text, text.is_some()), "status {status}");
        let none = on_skin("force = { above = 5.0 }\ncounts_as_touched = []", &message);
        assert_eq!(none, Assessment::default());
        let mut fused = robot("hand", 0.1);
        (fused.skins[0].status, fused.skins[0].status_text) = (status, "why".into());
        assert_eq!(on_body("force = { above = 5.0 }", &fused).loss.as_deref(), text);
    }
    let degraded = ContactArray { status: ContactArray::STATUS_DEGRADED, ..palm(vec![]) };
    assert!(on_skin("counts_as_touched = ['degraded']", &degraded).loss.is_some());
}

#[test]
fn a_skin_of_another_name_is_a_fault() {
    let message = ContactArray { skin: "sole".into(), ..palm(vec![]) };
    let found = on_skin("force = { above = 5.0 }", &message);
    assert_eq!(found.loss.unwrap(), "input `palm` brings skin `sole` where the rules say `palm`");
}

#[test]
fn a_skin_that_cannot_feel_the_limit_cannot_tell() {
    let message = ContactArray { force_threshold: 6.0, ..palm(vec![]) };
    let found = on_skin("force = { above = 5.0 }", &message);
    assert_eq!(
        found.loss.unwrap(),
        "skin `palm` reports no contact below 6.000 N, and the rule asks for 5 N"
    );
    let message = ContactArray { force_threshold: f32::NAN, ..palm(vec![]) };
    assert_eq!(on_skin("force = { above = 5.0 }", &message), Assessment::default());
    // At the end of the skin's range the force can be any.
    let message = ContactArray { force_max: 3.0, ..palm(vec![pressed(3.0)]) };
    assert!(on_skin("force = { above = 5.0 }", &message).touch.unwrap().contains("has no force"));
    assert!(on_skin("force = { above = 2.0 }", &message).touch.unwrap().contains("a force of 3 N"));
    assert!(
        on_skin("force = { above = 5.0 }", &ContactArray { force_max: 3.0, ..palm(vec![pressed(2.9)]) })
            .touch
            .is_none()
    );
}

#[test]
fn a_region_is_links_or_skins() {
    let rule = "force = { above = 5.0 }\nregion = ";
    for (region, hand, foot) in [("'hand'", true, false), ("'named'", true, false)] {
        let of = |link: &str| on_body(&format!("{rule}{region}"), &robot(link, 9.0)).touch.is_some();
        assert_eq!((of("hand"), of("foot")), (hand, foot), "{region}");
    }
    assert!(on_body("force = { above = 5.0 }", &robot("foot", 9.0)).touch.is_some(), "everything");
    let mut message = robot("foot", 9.0);
    message.contacts[0].other_links = vec!["hand".into()];
    assert!(on_body(&format!("{rule}'hand'"), &message).touch.is_some(), "it may be there");
    // A skin elsewhere does not matter, one in the region does.
    let mut message = robot("hand", 0.1);
    message.skins[1].status = ContactArray::STATUS_STALE;
    message.status = ContactArray::STATUS_STALE;
    assert!(on_body(&format!("{rule}'hand'"), &message).loss.is_none());
    assert!(on_body("force = { above = 5.0 }", &message).loss.is_some());
}

#[test]
fn skins_that_the_fusion_does_not_name_are_missing() {
    let mut message = robot("hand", 0.1);
    message.skins.clear();
    let found = on_body("force = { above = 5.0 }\ninputs = ['body']", &message);
    assert_eq!(found.loss.unwrap(), "the fused contacts name no skin at all");
    for region in ["hand", "named"] {
        let rule = format!("force = {{ above = 5.0 }}\nregion = '{region}'\n");
        let found = on_body(&format!("{rule}inputs = ['body']"), &message);
        assert!(found.loss.unwrap().starts_with("the fused contacts name no skin for `"), "{region}");
        assert!(on_body(&rule, &message).loss.is_none(), "the palm speaks for itself");
    }
    // It has never been heard.
    let mut message = robot("hand", 0.1);
    message.skins[0] =
        SkinHealth { stamp: Time::default(), ..health("palm", "hand", ContactArray::STATUS_STALE) };
    assert_eq!(on_body("counts_as_touched = ['missing']", &message).loss.unwrap(), "skin `palm` is missing");
    assert!(on_body("counts_as_touched = ['stale']", &message).loss.is_none());
}

#[test]
fn a_fusion_at_fault_is_not_trusted() {
    let message = BodyContacts {
        status: ContactArray::STATUS_FAULT,
        status_text: "no joint states".into(),
        ..robot("hand", 0.1)
    };
    let found = on_body("force = { above = 5.0 }\nregion = 'hand'", &message);
    assert_eq!(found.loss.unwrap(), "the fused contacts are at fault: no joint states");
}

#[test]
fn slip_and_speed_come_from_the_fusion() {
    let mut message = robot("hand", 1.0);
    let slipping = |rule: &str, slip: u8, message: &mut BodyContacts| {
        message.contacts[0].slip = slip;
        on_body(rule, message).touch
    };
    for (slip, gross, incipient) in [
        (BodyContact::SLIP_NONE, false, false),
        (BodyContact::SLIP_INCIPIENT, false, true),
        (BodyContact::SLIP_GROSS, true, true),
        (BodyContact::SLIP_UNKNOWN, true, true),
    ] {
        assert_eq!(slipping("slip = 'gross'", slip, &mut message).is_some(), gross, "{slip}");
        assert_eq!(slipping("slip = 'incipient'", slip, &mut message).is_some(), incipient, "{slip}");
    }
    // What moves along the normal does not slide.
    message.contacts[0].velocity = Vector3 { x: 0.03, y: 0.04, z: 9.0 };
    assert!(on_body("speed = { above = 0.051 }", &message).touch.is_none());
    let found = on_body("speed = { above = 0.049 }", &message);
    assert_eq!(found.touch.unwrap(), "a sliding speed of 0.05 m/s on link `hand` is above 0.049 m/s");
}

#[test]
fn expected_and_doubtful_contacts_can_be_left_out() {
    let mut message = robot("hand", 9.0);
    let rule = "force = { above = 5.0 }\nignore = ['expected']\nleast_confidence = 0.5";
    assert!(on_body(rule, &message).touch.is_some());
    message.contacts[0].cause = BodyContact::CAUSE_EXPECTED;
    assert_eq!(on_body(rule, &message), Assessment::default());
    message.contacts[0].cause = BodyContact::CAUSE_SELF;
    assert!(on_body(rule, &message).touch.is_some());
    message.contacts[0].contact.confidence = 0.4;
    assert_eq!(on_body(rule, &message), Assessment::default());
    message.contacts[0].contact.confidence = f32::NAN;
    assert!(on_body(rule, &message).touch.is_some(), "an unknown confidence is no low one");
}

#[test]
fn the_inputs_are_those_of_the_file() {
    let rules = rules("force = { above = 5.0 }");
    assert_eq!((rules.inputs[BODY].name.as_str(), rules.inputs[PALM].name.as_str()), ("body", "palm"));
}
