use super::*;

const ROBOT: &str = r#"
schema = "dermis-robot/1"
name = "arm"
urdf = "arm.urdf"
base = "fore"

[[skins]]
name = "left"
taxels = "left.txt"
mount = { parent = "fore", translation = [0.0, 0.0, 0.1], rpy = [0.0, 1.5707963267948966, 0.0] }

[[skins]]
name = "tip"
skin = "pad.toml"
frame_id = "base"
namespace = "/arm/tip/"
timeout = 0.5
"#;

const URDF: &str = r#"<robot name="arm"><link name="base"/><link name="fore"/>
    <joint name="elbow" type="continuous"><parent link="base"/><child link="fore"/></joint></robot>"#;

fn read(text: &str) -> Result<Robot, RobotError> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arm.urdf"), URDF).unwrap();
    std::fs::write(folder.path().join("left.txt"), "[calibration]\n0 0 0 0 0 0\n0.01 0 0 0 0 1\n").unwrap();
    std::fs::write(folder.path().join("pad.toml"), include_str!("../../../../launch/skins/baro-grid.toml"))
        .unwrap();
    let robot = Robot::from_toml(text, &folder.path().join("arm.toml"))?;
    robot.taxels()?;
    Ok(robot)
}

/// The refusal of the file with this replacement, without the folder of the test.
fn refused(from: &str, to: &str) -> String {
    assert!(ROBOT.contains(from));
    let error = read(&ROBOT.replace(from, to)).unwrap_err().to_string();
    match (error.find('/'), error.find("/arm.toml")) {
        (Some(start), Some(end)) => format!("{}{}", &error[..start], &error[end + 1..]),
        _ => error,
    }
}

#[test]
fn skins_have_names_poses_and_taxels() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arm.urdf"), URDF).unwrap();
    std::fs::write(folder.path().join("left.txt"), "[calibration]\n0 0 0 0 0 0\n0.01 0 0 0 0 1\n").unwrap();
    std::fs::write(folder.path().join("pad.toml"), include_str!("../../../../launch/skins/baro-grid.toml"))
        .unwrap();
    let robot = Robot::from_toml(ROBOT, &folder.path().join("arm.toml")).unwrap();
    assert_eq!((robot.base, robot.skins.len()), (1, 2));
    let [left, tip] = robot.skins.as_slice() else { panic!("two skins") };
    assert_eq!((left.frame_id.as_str(), left.namespace.as_str(), left.timeout), ("left_skin", "/left", 0.2));
    assert_eq!((tip.link, tip.namespace.as_str(), tip.timeout), (0, "/arm/tip", 0.5));
    let taxels = robot.taxels().unwrap();
    assert_eq!(taxels.len(), 1 + 25);
    // Pitch by 90° takes x of the skin to −z of the link, and z to x.
    assert_eq!((taxels[0].skin, taxels[0].index), (0, 1));
    assert!((taxels[0].position - Point3::new(0.0, 0.0, 0.09)).norm() < 1e-12);
    assert!((taxels[0].normal.unwrap() - Vector3::x()).norm() < 1e-12);
}

#[test]
fn rates_are_those_of_the_robot_file_or_of_the_types() {
    let rates = |robot: &Robot| robot.skins.iter().map(|skin| skin.rate).collect::<Vec<_>>();
    assert_eq!(rates(&read(ROBOT).unwrap()), [None, Some(100.0)]);
    let stated = ROBOT.replace("timeout = 0.5", "rate = 1000.0").replace("taxels =", "rate = 50.0\ntaxels =");
    assert_eq!(rates(&read(&stated).unwrap()), [Some(50.0), Some(1000.0)]);
    let missing = read(&ROBOT.replace("pad.toml", "none.toml")).unwrap_err();
    assert!(matches!(missing, RobotError::Skin(SkinError::Read { .. })), "{missing}");
    // A computer that runs no skin need not have its file.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arm.urdf"), URDF).unwrap();
    Robot::from_toml(&stated, &folder.path().join("arm.toml")).unwrap();
}

#[test]
fn an_srdf_says_which_links_may_touch_each_other() {
    let load = |elements: &str| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("arm.urdf"), URDF).unwrap();
        let text = format!("<robot name='arm'>\n{elements}</robot>");
        std::fs::write(folder.path().join("arm.srdf"), text).unwrap();
        let robot = ROBOT.replace("urdf = \"arm.urdf\"", "urdf = \"arm.urdf\"\nsrdf = \"arm.srdf\"");
        let robot = robot.replace("skin = \"pad.toml\"\n", "");
        Robot::from_toml(&robot, &folder.path().join("arm.toml")).map(|robot| robot.self_contact)
    };
    assert_eq!(load("").unwrap(), [[0_usize; 2]; 0]);
    assert_eq!(load("<disable_collisions link1='fore' link2='base' reason='Adjacent'/>").unwrap(), [[0, 1]]);
    let wrong = load("<disable_collisions link1='fore' link2='hand' reason='Adjacent'/>").unwrap_err();
    assert!(wrong.to_string().contains("arm.srdf: line 2: disable_collisions of robot \"arm\": "), "{wrong}");
    assert!(read(ROBOT).unwrap().self_contact.is_empty());
}

#[test]
fn refusals_name_file_field_and_remedy() {
    insta::assert_snapshot!(refused("dermis-robot/1", "dermis-robot/9"), @r#"robot file arm.toml: field `schema`: is "dermis-robot/9" where this program reads "dermis-robot/1""#);
    insta::assert_snapshot!(refused("base = \"fore\"", "base = \"hand\""), @r#"robot file arm.toml: field `base`: "hand" is no link of arm.urdf"#);
    insta::assert_snapshot!(refused("timeout = 0.5", "timout = 0.5"), @"robot file arm.toml: unknown key `skins[1].timout`; remove it or correct its spelling (known here: schema, name, urdf, srdf, base, skins; in skins: name, skin, taxels, namespace, frame_id, mount, timeout, rate)");
    insta::assert_snapshot!(refused("timeout = 0.5", "timeout = -1"), @"robot file arm.toml: field `skins[1].timeout`: is -1 s and must be from 0.001 to 3600");
    insta::assert_snapshot!(refused("timeout = 0.5", "rate = 0"), @"robot file arm.toml: field `skins[1].rate`: is 0 Hz and must be from 0.001 to 1000000");
    insta::assert_snapshot!(refused("parent = \"fore\"", "parent = \"hand\""), @r#"robot file arm.toml: field `skins[0].mount.parent`: "hand" is no link of the URDF; correct the name"#);
    insta::assert_snapshot!(refused("frame_id = \"base\"", "frame_id = \"elsewhere\""), @r#"robot file arm.toml: field `skins[1].mount`: is missing, and "elsewhere" is no link of the URDF; say which link the skin is fixed to"#);
    insta::assert_snapshot!(refused("name = \"left\"", "name = \"left\"\nframe_id = \"fore\""), @r#"robot file arm.toml: field `skins[0].frame_id`: "fore" is a link of the URDF, which places it already; take another name, or remove `mount`"#);
    insta::assert_snapshot!(refused("name = \"tip\"", "name = \"left\""), @r#"robot file arm.toml: field `skins[1].name`: "left" is that of skins[0] already; each device has its own"#);
    insta::assert_snapshot!(refused("namespace = \"/arm/tip/\"", "namespace = \"tip\""), @r#"robot file arm.toml: field `skins[1].namespace`: "tip" is no absolute namespace: begin with `/`, and take letters, digits and `_`"#);
}

/// Real geometry at scale: the skins of an iCub on the links that their tables name.
#[test]
fn the_skins_of_an_icub_load() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/icub_skin_positions");
    if !folder.is_dir() {
        eprintln!("skipped: the tables of the iCub's skins are not at {}", folder.display());
        return;
    }
    let parts: Vec<String> = ["left", "right"]
        .iter()
        .flat_map(|side| {
            ["arm", "forearm_V2", "hand_V2_1", "leg_upper", "leg_lower", "foot"]
                .map(|part| format!("{side}_{part}"))
        })
        .chain(["torso".to_owned()])
        .collect();
    let mut urdf = String::from("<robot name='icub'><link name='root_link'/>");
    let mut robot = String::from("schema = 'dermis-robot/1'\nname = 'icub'\nurdf = 'icub.urdf'\n");
    for part in &parts {
        urdf += &format!(
            "<link name='{part}'/><joint name='{part}_joint' type='revolute'><parent link='root_link'/><child link='{part}'/></joint>"
        );
        let table = folder.join(format!("{part}.txt"));
        robot += &format!(
            "[[skins]]\nname = '{part}_skin'\nframe_id = '{part}'\ntaxels = '{}'\n",
            table.display()
        );
    }
    let home = tempfile::tempdir().unwrap();
    std::fs::write(home.path().join("icub.urdf"), urdf + "</robot>").unwrap();
    let robot = Robot::from_toml(&robot, &home.path().join("icub.toml")).unwrap();
    let taxels = robot.taxels().unwrap();
    assert!(taxels.len() > 1000, "{} taxels", taxels.len());
    for (s, skin) in robot.skins.iter().enumerate() {
        let of_skin = taxels.iter().filter(|t| t.skin == s);
        assert!(of_skin.clone().count() > 10, "{}", skin.name);
        assert!(
            of_skin.clone().all(|t| t.position.coords.norm() < 0.5),
            "{}: within half a metre of its link",
            skin.name
        );
        assert!(of_skin.filter_map(|t| t.normal).all(|n| (n.norm() - 1.0).abs() < 1e-9));
    }
}
