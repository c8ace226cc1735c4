use super::*;
use crate::rules::ActionKind;
use crate::rules::{AtEnd, Cause, Start};

const WHOLE: &str = r#"schema = "dermis-reflex/1"
name = "arm"
start = "clear"
at_end = "silent"

[inputs.body]
kind = "body"
topic = "body_contacts"
timeout = 0.05
max_age = 0.1

[inputs.palm]
kind = "skin"
topic = "/palm/contacts"
skin = "left_palm"
link = "left_hand"
timeout = 0.02

[regions.hands]
links = ["left_hand"]

[limits.hand]
quasi_static = { force = 2.0, pressure = 3.0 }
transient = { force = 4.0 }
time_to_quasi_static = 0.5

[actions.stop]
kind = "bool"
topic = "stop"
heartbeat = 0.1

[actions.slow]
kind = "speed_scale"
topic = "scale"
scale = 0.25
repeat = 0.02

[actions.halt]
kind = "twist"
topic = "cmd_vel"
stamped = "base"

[actions.off]
kind = "trigger"
service = "power_off"

[actions.cancel]
kind = "cancel"
action = "follow"

[[rules]]
name = "hand"
region = "hands"
force = { above = 5.0, release = 4.0 }
pressure = { above = 12.0 }
limits = "hand"
sigmas = 2.0
actions = ["stop", "off", "cancel"]

[[rules]]
name = "slide"
inputs = ["body"]
slip = "gross"
speed = { above = 0.02 }
counts_as_touched = ["missing"]
ignore = ["self", "expected"]
latch = false
hold = 0.01
quiet = 1.0
least_confidence = 0.5
peak_over_mean = 1.0
actions = ["slow", "halt"]
"#;

fn refusal(text: &str) -> String {
    Rules::from_toml(text, "arm.toml").unwrap_err().to_string()
}

/// The refusal of the whole file with one part replaced.
fn changed(from: &str, to: &str) -> String {
    assert_eq!(WHOLE.matches(from).count(), 1, "{from}");
    refusal(&WHOLE.replace(from, to))
}

#[test]
fn a_whole_file_is_read() {
    let rules = Rules::from_toml(WHOLE, "arm.toml").unwrap();
    assert_eq!((rules.name.as_str(), rules.start, rules.at_end), ("arm", Start::Clear, AtEnd::Silent));
    let [body, palm] = rules.inputs.as_slice() else { panic!("{:?}", rules.inputs) };
    assert_eq!(
        (&body.kind, body.timeout.as_millis(), body.max_age.unwrap().as_millis()),
        (&InputKind::Body, 50, 100)
    );
    assert_eq!(palm.kind, InputKind::Skin { skin: Some("left_palm".into()), link: Some("left_hand".into()) });
    let action = |name: &str| rules.actions.iter().find(|action| action.name == name).unwrap();
    assert_eq!(action("stop").kind, ActionKind::Bool { topic: "stop".into(), value: true });
    assert_eq!((action("stop").repeat.as_millis(), action("stop").heartbeat.unwrap().as_millis()), (50, 100));
    assert_eq!(action("slow").repeat.as_millis(), 20);
    assert_eq!(action("off").repeat.as_millis(), 500, "a call");
    assert_eq!(
        action("halt").kind,
        ActionKind::Twist { topic: "cmd_vel".into(), stamped: Some("base".into()) }
    );

    let [hand, slide] = rules.rules.as_slice() else { panic!("{:?}", rules.rules) };
    assert_eq!(hand.inputs, [0, 1], "both tell of the hand");
    assert_eq!(hand.force, Some(Threshold { above: 5.0, release: 4.0 }));
    assert_eq!(hand.pressure.unwrap().above, 12e4, "12 N/cm² in Pa");
    assert_eq!(hand.counts_as_touched, Loss::USUAL);
    assert!(hand.latch && hand.hold.is_zero());
    let names: Vec<&str> = hand.actions.iter().map(|i| rules.actions[*i].name.as_str()).collect();
    assert_eq!(names, ["stop", "off", "cancel"]);
    let limits = hand.limits.as_ref().unwrap();
    assert_eq!(limits.quasi_static, LimitPair { force: Some(2.0), pressure: Some(3e4) });
    assert_eq!(
        limits.transient,
        LimitPair { force: Some(4.0), pressure: Some(3e4) },
        "none given: none allowed"
    );
    assert_eq!((slide.inputs.as_slice(), slide.latch, slide.hold.as_millis()), (&[0][..], false, 10));
    assert_eq!(slide.ignore, [Cause::SelfContact, Cause::Expected]);
    assert!(slide.counts(Loss::Missing) && !slide.counts(Loss::Late));
}

#[test]
fn a_file_with_placeholders_is_refused() {
    let text = WHOLE.replace("name = \"arm\"", "name = \"arm\"\nplaceholders = true");
    insta::assert_snapshot!(refusal(&text), @"rule file arm.toml: line 3: field `placeholders`: the values of this file are placeholders: replace each by that of your own risk assessment, then remove this line");
}

#[test]
fn refusals_name_file_line_and_field() {
    insta::assert_snapshot!(refusal("schema = "), @"rule file arm.toml: line 1: string values must be quoted, expected literal string");
    insta::assert_snapshot!(changed("dermis-reflex/1", "dermis-reflex/2"), @r#"rule file arm.toml: line 1: field `schema`: is "dermis-reflex/2" where this program reads "dermis-reflex/1""#);
    insta::assert_snapshot!(changed("kind = \"twist\"", "kind = \"twirl\""), @"rule file arm.toml: line 39: field `actions.halt.kind`: unknown variant `twirl`, expected one of `bool`, `empty`, `twist`, `speed_scale`, `trigger`, `cancel`");
    insta::assert_snapshot!(changed("timeout = 0.02", "timeout = \"soon\""), @r#"rule file arm.toml: line 17: field `inputs.palm.timeout`: invalid type: string "soon", expected f64"#);
    insta::assert_snapshot!(changed("timeout = 0.02", "timeout = 0.0"), @"rule file arm.toml: line 17: field `inputs.palm.timeout`: is 0 and must be between 0.0001 and 86400");
    insta::assert_snapshot!(changed("timeout = 0.02\n", ""), @"rule file arm.toml: line 12: field `inputs.palm`: missing field `timeout`");
    insta::assert_snapshot!(changed("latch = false", "lach = false"), @"rule file arm.toml: line 67: field `rules[1].lach`: is not known; remove it or correct its spelling");
    insta::assert_snapshot!(changed("{ above = 12.0 }", "{ abov = 12.0 }"), @"rule file arm.toml: line 55: field `rules[0].pressure.abov`: is not known; remove it or correct its spelling");
    insta::assert_snapshot!(changed("topic = \"scale\"", "tpoic = \"scale\""), @"rule file arm.toml: line 34: field `actions.slow.tpoic`: is not known; remove it or correct its spelling");
    insta::assert_snapshot!(changed("release = 4.0", "release = 5.5"), @"rule file arm.toml: line 54: field `rules[0].force.release`: is 5.5 and may not be larger than `above`, 5");
    insta::assert_snapshot!(changed("force = 4.0", "force = 1.5"), @"rule file arm.toml: line 24: field `limits.hand.transient.force`: is below that of a quasi-static contact; a short contact is allowed no less than a long one");
    insta::assert_snapshot!(changed("force = 2.0, ", ""), @"rule file arm.toml: line 23: field `limits.hand.quasi_static.force`: is missing, while `transient` gives it; a contact that begins could last");
    insta::assert_snapshot!(changed("region = \"hands\"", "region = \"feet\""), @r#"rule file arm.toml: line 53: field `rules[0].region`: "feet" is not in this file; there are: hands"#);
    insta::assert_snapshot!(changed("inputs = [\"body\"]", "inputs = [\"palms\"]"), @r#"rule file arm.toml: line 62: field `rules[1].inputs[0]`: "palms" is not in this file; there are: body, palm"#);
    insta::assert_snapshot!(changed("[\"slow\", \"halt\"]", "[\"slow\", \"hold\"]"), @r#"rule file arm.toml: line 72: field `rules[1].actions[1]`: "hold" is not in this file; there are: cancel, halt, off, slow, stop"#);
    insta::assert_snapshot!(changed("[\"slow\", \"halt\"]", "[\"slow\"]"), @"rule file arm.toml: line 38: field `actions.halt`: no rule does it; remove it");
    insta::assert_snapshot!(changed("links = [\"left_hand\"]", ""), @"rule file arm.toml: line 19: field `regions.hands`: has neither `links` nor `skins`; a rule without `region` is for the whole robot");
    insta::assert_snapshot!(changed("service = \"power_off\"", "topic = \"power_off\""), @"rule file arm.toml: line 45: field `actions.off.topic`: is of no use for this kind of action; remove it");
    insta::assert_snapshot!(changed("topic = \"scale\"", "topic = \"stop\""), @"rule file arm.toml: line 27: field `actions.stop`: goes where `slow` goes; let the rules share one action");
    insta::assert_snapshot!(changed("name = \"slide\"", "name = \"hand\""), @r#"rule file arm.toml: line 61: field `rules[1].name`: "hand" is the name of rules[0] already"#);
    insta::assert_snapshot!(changed("sigmas = 2.0", "sigmas = -1.0"), @"rule file arm.toml: line 57: field `rules[0].sigmas`: is -1 and must be between 0 and 100");
    insta::assert_snapshot!(changed("scale = 0.25", ""), @"rule file arm.toml: line 32: field `actions.slow.scale`: is missing; give the share of the speed, 0 to 1");
    insta::assert_snapshot!(changed("above = 0.02", "above = nan"), @"rule file arm.toml: line 64: field `rules[1].speed.above`: is NaN and must be between 0 and 1000000000");
}

#[test]
fn a_part_that_nobody_feels_is_refused() {
    let text = WHOLE
        .replace("[regions.hands]", "[regions.feet]\nlinks = [\"foot\"]\n[regions.hands]")
        .replace("region = \"hands\"", "region = \"feet\"\ninputs = [\"palm\"]");
    insta::assert_snapshot!(refusal(&text), @r#"rule file arm.toml: line 56: field `rules[0].inputs[0]`: "palm" says nothing of the rule's region: give the input a `link` or a `skin` of it"#);
    let text = WHOLE
        .replace("links = [\"left_hand\"]", "links = [\"left_hand\", \"foot\"]")
        .replace("region = \"hands\"", "region = \"hands\"\ninputs = [\"palm\"]");
    insta::assert_snapshot!(refusal(&text), @"rule file arm.toml: line 53: field `rules[0].region`: no input that the rule listens to can tell of `foot`: add one, or give one its `link` or `skin`");
}

#[test]
fn a_rule_that_can_never_act_is_refused() {
    let text = WHOLE.replace(
        "slip = \"gross\"\nspeed = { above = 0.02 }\ncounts_as_touched = [\"missing\"]",
        "counts_as_touched = []",
    );
    insta::assert_snapshot!(refusal(&text), @"rule file arm.toml: line 61: field `rules[1].name`: can never act: give `force`, `pressure`, `speed`, `slip`, `limits` or `counts_as_touched`");
}

#[test]
fn files_are_read_from_disk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("arm.toml");
    assert!(Rules::load(&path).unwrap_err().to_string().contains("arm.toml: cannot be read"));
    std::fs::write(&path, WHOLE).unwrap();
    assert_eq!(Rules::load(&path).unwrap(), Rules::from_toml(WHOLE, "x").unwrap());
}

proptest::proptest! {
    /// No text makes the reader panic, and an error names a line of the text.
    #[test]
    fn no_text_panics(cut in 0..WHOLE.len(), junk in "[\\[\\]{}=\"a-z0-9.\n]{0,12}", keep in 0..WHOLE.len()) {
        let (cut, keep) = (cut.min(keep), cut.max(keep));
        let text = format!("{}{junk}{}", &WHOLE[..cut], &WHOLE[keep..]);
        if let Err(RuleFileError::Field { line, .. } | RuleFileError::Syntax { line, .. }) = Rules::from_toml(&text, "f") {
            proptest::prop_assert!(line >= 1 && line <= 1 + text.matches('\n').count());
        }
    }
}

/// The rule file that ships fits the robot that ships, and cannot be used as it is.
#[test]
fn the_rules_of_the_humanoid_are_refused_until_they_are_made_ones_own() {
    let launch = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch");
    let path = launch.join("reflex/humanoid.reflex.toml");
    assert!(Rules::load(&path).unwrap_err().to_string().contains("field `placeholders`"));
    let text = std::fs::read_to_string(&path).unwrap();
    let own = text.replace("placeholders = true\n", "");
    let rules = Rules::from_toml(&own, "own").unwrap();
    let robot = dermis_body::Robot::load(launch.join("robots/humanoid.toml")).unwrap();
    let covered: Vec<&str> = robot.skins.iter().map(|skin| robot.body.links()[skin.link].as_str()).collect();
    for rule in &rules.rules {
        for link in &rule.region.links {
            assert!(
                covered.contains(&link.as_str()),
                "rule `{}`: no skin is on {link}: {covered:?}",
                rule.name
            );
        }
    }
}
