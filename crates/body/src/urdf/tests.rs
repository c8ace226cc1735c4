use super::*;
use proptest::prelude::*;

const ARM: &str = r#"<?xml version="1.0"?>
<robot name="arm">
  <material name="grey"/>
  <link name="base"><inertial/></link>
  <link name="upper"/>
  <link name="fore"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/> <axis xyz="0 2 0"/>
    <limit lower="-1" upper="2" velocity="3" effort="40"/> <dynamics friction="0.5" damping="0.2"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/> <child link="fore"/> <mimic joint="shoulder" multiplier="-0.5" offset="0.1"/>
  </joint>
</robot>"#;

fn refused(from: &str, to: &str) -> String {
    assert!(ARM.contains(from), "{from}");
    Body::from_urdf(&ARM.replace(from, to), "arm.urdf").unwrap_err().to_string()
}

#[test]
fn links_joints_and_limits_are_read() {
    let body = Body::from_urdf(ARM, "arm.urdf").unwrap();
    assert_eq!((body.name(), body.links().len(), body.root()), ("arm", 3, 0));
    let shoulder = &body.joints()[0];
    assert_eq!(shoulder.limits, Some(Limits { lower: -1.0, upper: 2.0, velocity: 3.0, effort: 40.0 }));
    assert_eq!(shoulder.friction, Friction { coulomb: 0.5, viscous: 0.2 });
    assert_eq!(body.joints()[1].friction, Friction::default());
    assert_eq!(*shoulder.axis, Vector3::y(), "axes are made unit");
    assert_eq!(body.coordinates().map(|j| j.name.as_str()).collect::<Vec<_>>(), ["shoulder"]);
    assert_eq!(body.joints()[1].moved_by, Some(Mimic { coordinate: 0, multiplier: -0.5, offset: 0.1 }));
    assert_eq!(body.joints()[1].axis, Vector3::x_axis(), "the axis of URDF where none is given");
}

#[test]
fn inertias_are_read() {
    let turned = r#"<link name="upper"><inertial><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/><mass value="2.5"/>
        <inertia ixx="0.3" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.35"/></inertial></link>"#;
    let body = Body::from_urdf(&ARM.replace("<link name=\"upper\"/>", turned), "arm.urdf").unwrap();
    assert_eq!((body.inertia(0), body.inertia(2)), (None, None), "an empty element tells nothing");
    let inertia = body.inertia(1).unwrap();
    assert_eq!((inertia.mass, inertia.center.x), (2.5, 0.1));
    assert!((inertia.tensor - Matrix3::from_diagonal(&Vector3::new(0.1, 0.3, 0.35))).norm() < 1e-12);
    let wrong = turned.replace("2.5", "heavy");
    insta::assert_snapshot!(refused("<link name=\"upper\"/>", &wrong), @r#"robot description arm.urdf: line 5: mass of link "upper": `value` is "heavy" and must be a finite number"#);
}

#[test]
fn chains_of_followers_end_at_the_one_that_is_free() {
    let third = r#"<link name="hand"/><joint name="wrist" type="prismatic"><parent link="fore"/><child link="hand"/>
        <mimic joint="elbow" multiplier="3" offset="1"/></joint></robot>"#;
    let body = Body::from_urdf(&ARM.replace("</robot>", third), "arm.urdf").unwrap();
    let Some(Mimic { coordinate: 0, multiplier, offset }) = body.joints()[2].moved_by else {
        panic!("follows")
    };
    // 3 (−0.5 q + 0.1) + 1
    assert!((multiplier + 1.5).abs() < 1e-12 && (offset - 1.3).abs() < 1e-12);
}

#[test]
fn elements_that_cannot_be_are_named() {
    insta::assert_snapshot!(refused("xyz=\"0 0 1\"", "xyz=\"0 nan 1\""), @r#"robot description arm.urdf: line 9: origin of joint "shoulder": `xyz` is "0 nan 1" and must be three finite numbers"#);
    insta::assert_snapshot!(refused("xyz=\"0 0 1\"", "xyz=\"0 1\""), @r#"robot description arm.urdf: line 9: origin of joint "shoulder": `xyz` is "0 1" and must be three finite numbers"#);
    insta::assert_snapshot!(refused("xyz=\"0 0 1\"", "xyz=\"0 0 1000\""), @r#"robot description arm.urdf: line 9: origin of joint "shoulder": `xyz` is [0.0, 0.0, 1000.0], more than 100 m; give metres"#);
    insta::assert_snapshot!(refused("1.5707963267948966", "90"), @r#"robot description arm.urdf: line 9: origin of joint "shoulder": `rpy` is [0.0, 0.0, 90.0], more than 10 rad; give radians"#);
    insta::assert_snapshot!(refused("\"0 2 0\"", "\"0 0 0\""), @r#"robot description arm.urdf: line 9: axis of joint "shoulder": has no direction; give a vector of length 1"#);
    insta::assert_snapshot!(refused("lower=\"-1\"", "lower=\"7\""), @r#"robot description arm.urdf: line 10: limit of joint "shoulder": `lower` is 7 and above `upper`, 2; exchange them"#);
    insta::assert_snapshot!(refused("damping=\"0.2\"", "damping=\"-1\""), @r#"robot description arm.urdf: line 10: dynamics of joint "shoulder": `damping` is -1 and must be 0 or more"#);
    insta::assert_snapshot!(refused("type=\"revolute\"", "type=\"floating\""), @r#"robot description arm.urdf: line 7: joint "shoulder": has type "floating"; fixed, revolute, continuous and prismatic are known: write a joint of several degrees of freedom as several joints"#);
    insta::assert_snapshot!(refused("<child link=\"fore\"/>", ""), @r#"robot description arm.urdf: line 12: joint "elbow": has no <child link="…"/>; add it"#);
    insta::assert_snapshot!(refused("<child link=\"fore\"/>", "<child link=\"hand\"/>"), @r#"robot description arm.urdf: line 12: joint "elbow": names link "hand" as child, and there is none; add it or correct the name"#);
    insta::assert_snapshot!(refused("joint=\"shoulder\"", "joint=\"hip\""), @r#"robot description arm.urdf: line 12: joint "elbow": follows joint "hip", and there is no joint of that name that moves"#);
    insta::assert_snapshot!(refused("joint=\"shoulder\"", "joint=\"elbow\""), @r#"robot description arm.urdf: line 12: joint "elbow": follows itself over other joints; let one of them follow nobody"#);
    insta::assert_snapshot!(refused("<link name=\"fore\"/>", "<link name=\"fore\"/><link name=\"fore\"/>"), @r#"robot description arm.urdf: line 6: link "fore": is there already, in line 6; give each its own name"#);
    insta::assert_snapshot!(refused("<robot name=\"arm\">", "<sdf>").replace("arm.urdf", "F").chars().take(40).collect::<String>(), @"robot description F: is no well-formed X");
}

#[test]
fn links_and_joints_make_one_tree() {
    insta::assert_snapshot!(refused("<link name=\"fore\"/>", "<link name=\"fore\"/><link name=\"tool\"/>"), @r#"robot description arm.urdf: has 2 roots, links that no joint carries: base, tool; join them by joints (type "fixed" where nothing moves)"#);
    insta::assert_snapshot!(refused("<child link=\"fore\"/>", "<child link=\"upper\"/>"), @r#"robot description arm.urdf: line 12: joint "elbow": carries its own parent; name another link"#);
    insta::assert_snapshot!(refused("<parent link=\"base\"/>", "<parent link=\"fore\"/>"), @r#"robot description arm.urdf: joints shoulder, elbow form a loop that the root "base" does not carry; remove the joint that closes it"#);
    let twice =
        r#"<joint name="second" type="fixed"><parent link="base"/><child link="fore"/></joint></robot>"#;
    insta::assert_snapshot!(refused("</robot>", twice), @r#"robot description arm.urdf: line 15: joint "second": carries link "fore", which joint "elbow" carries already; remove one of them"#);
    let closes =
        r#"<joint name="second" type="fixed"><parent link="fore"/><child link="base"/></joint></robot>"#;
    insta::assert_snapshot!(refused("</robot>", closes), @"robot description arm.urdf: every link is carried by a joint, so that the joints form a loop; remove the joint that closes it");
    insta::assert_snapshot!(Body::from_urdf("<robot name='r'/>", "r").unwrap_err(), @r#"robot description r: line 1: robot "r": has no link; a body has one at least"#);
}

#[test]
fn xacro_and_document_types_are_refused() {
    let xacro =
        r#"<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r"><xacro:macro name="leg"/></robot>"#;
    insta::assert_snapshot!(Body::from_urdf(xacro, "r").unwrap_err(), @r#"robot description r: line 1: macro "leg": is xacro, which is not expanded here; give the output of `xacro FILE`"#);
    let bomb = r#"<!DOCTYPE r [<!ENTITY a "aaaa">]><robot name="&a;"/>"#;
    assert!(
        Body::from_urdf(bomb, "r")
            .unwrap_err()
            .to_string()
            .starts_with("robot description r: is no well-formed XML")
    );
}

proptest! {
    #[test]
    fn no_text_panics(text in "(<robot>|<link name='a'/>|<joint name='b' type='fixed'>|<parent link='a'/>|</joint>|</robot>|<|>|.){0,12}") {
        let _ = Body::from_urdf(&text, "x");
    }
}
