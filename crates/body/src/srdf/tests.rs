use std::fmt::Write;

use proptest::prelude::*;

use super::*;

const LINKS: [&str; 6] = ["base", "chest", "upper", "fore", "hand", "tip"];

/// A chain of all links.
fn arm() -> Body {
    let mut urdf = String::from("<robot name='arm'>");
    LINKS.iter().for_each(|link| write!(urdf, "<link name='{link}'/>").unwrap());
    for (i, ends) in LINKS.windows(2).enumerate() {
        let [parent, child] = ends else { panic!("two links") };
        write!(
            urdf,
            "<joint name='j{i}' type='continuous'><parent link='{parent}'/><child link='{child}'/></joint>"
        )
        .unwrap();
    }
    Body::from_urdf(&(urdf + "</robot>"), "arm.urdf").unwrap()
}

fn carriers(links: &[&str]) -> BTreeSet<usize> {
    links.iter().map(|link| LINKS.iter().position(|l| l == link).unwrap()).collect()
}

/// Names of the pairs that this file allows among links with skins.
fn pairs(elements: &str, with_skins: &[&str]) -> Result<Vec<[&'static str; 2]>, String> {
    let text = format!("<?xml version=\"1.0\"?>\n<robot name=\"arm\">\n{elements}\n</robot>");
    let found = read(&text, "arm.srdf", &arm(), &carriers(with_skins)).map_err(|e| e.to_string())?;
    Ok(found.into_iter().map(|links| links.map(|link| LINKS[link])).collect())
}

#[test]
fn planners_leave_pairs_out_for_reasons() {
    let file = r#"
        <!-- as the setup assistant of MoveIt writes it -->
        <group name="arm"><chain base_link="base" tip_link="tip"/></group>
        <group_state name="home" group="arm"><joint name="j0" value="0"/></group_state>
        <disable_collisions link1="fore" link2="upper" reason="Adjacent"/>
        <disable_collisions link1="hand" link2="chest" reason="Default"/>
        <disable_collisions link1="hand" link2="fore" reason="User"/>
        <disable_collisions link1="hand" link2="tip"/>
        <disable_collisions link1="chest" link2="tip" reason="Never"/>
        <disable_collisions link1="base" link2="chest" reason="Adjacent"/>"#;
    let mut expected = vec![["chest", "hand"], ["upper", "fore"], ["fore", "hand"], ["hand", "tip"]];
    assert_eq!(pairs(file, &["chest", "upper", "fore", "hand", "tip"]).unwrap(), expected);
    expected.retain(|pair| !pair.contains(&"tip"));
    assert_eq!(pairs(file, &["chest", "upper", "fore", "hand"]).unwrap(), expected);
    assert!(pairs("", &LINKS).unwrap().is_empty());
}

#[test]
fn defaults_of_a_link_are_overruled_by_its_pairs() {
    let file = r#"
        <disable_collisions link1="hand" link2="base" reason="never"/>
        <disable_collisions link1="fore" link2="hand" reason="Adjacent"/>
        <enable_collisions link1="hand" link2="upper"/>
        <enable_collisions link1="fore" link2="hand"/>
        <disable_default_collisions link="hand"/>"#;
    let expected = [["chest", "hand"], ["fore", "hand"], ["hand", "tip"]];
    assert_eq!(pairs(file, &LINKS).unwrap(), expected);
    assert!(pairs(file, &["chest", "fore", "tip"]).unwrap().is_empty(), "no skin is on the hand");
}

#[test]
fn elements_that_cannot_be_are_named() {
    let wrong = |elements: &str| pairs(elements, &LINKS).unwrap_err();
    insta::assert_snapshot!(wrong("<disable_collisions link1=\"hand\" reason=\"User\"/>"), @r#"robot description arm.srdf: line 3: disable_collisions of robot "arm": has no `link2`; name a link there"#);
    insta::assert_snapshot!(wrong("\n<disable_collisions link1=\"hand\" link2=\"head\"/>"), @r#"robot description arm.srdf: line 4: disable_collisions of robot "arm": names link "head" as `link2`, and the URDF has none of that name; correct it, or remove the line"#);
    insta::assert_snapshot!(wrong("<enable_collisions link1=\"tip\" link2=\" tip \"/>"), @r#"robot description arm.srdf: line 3: enable_collisions of robot "arm": names link "tip" twice; name two links"#);
    insta::assert_snapshot!(wrong("<disable_default_collisions/>"), @r#"robot description arm.srdf: line 3: disable_default_collisions of robot "arm": has no `link`; name a link there"#);
    insta::assert_snapshot!(wrong("<x:macro xmlns:x=\"http://www.ros.org/wiki/xacro\"/>"), @r#"robot description arm.srdf: line 3: macro of robot "arm": is xacro, which is not expanded here; give the output of `xacro FILE`"#);
    let whole = |text: &str| read(text, "arm.srdf", &arm(), &carriers(&LINKS)).unwrap_err().to_string();
    insta::assert_snapshot!(whole("<robot name=\"leg\"/>"), @r#"robot description arm.srdf: line 1: robot "leg": is another robot than "arm" of the URDF; give the SRDF of that robot"#);
    insta::assert_snapshot!(whole("<sdf/>"), @"robot description arm.srdf: line 1: sdf: is not the element `robot` that an SRDF begins with; give another file");
    assert!(whole("<robot").starts_with("robot description arm.srdf: is no well-formed XML: "));
    let missing = load(Path::new("/nowhere/arm.srdf"), &arm(), &carriers(&LINKS)).unwrap_err();
    assert!(missing.to_string().starts_with("robot description /nowhere/arm.srdf: cannot be read: "));
}

proptest! {
    /// Which link is written first does not matter, and the last word on a pair counts.
    #[test]
    fn pairs_are_those_whose_last_reason_is_not_never(
        lines in prop::collection::vec((0..LINKS.len(), 0..LINKS.len(), any::<bool>(), 0..4_usize), 0..30)
    ) {
        let (mut file, mut last) = (String::new(), BTreeMap::new());
        for (a, b, turned, reason) in lines.into_iter().filter(|(a, b, ..)| a != b) {
            let reason = ["Adjacent", "Never", "User", ""][reason];
            let (one, two) = if turned { (a, b) } else { (b, a) };
            writeln!(
                file,
                "<disable_collisions link1='{}' link2='{}' reason='{reason}'/>", LINKS[one], LINKS[two]
            ).unwrap();
            last.insert((a.min(b), a.max(b)), reason);
        }
        let expected: Vec<[&str; 2]> = last
            .into_iter()
            .filter(|((a, b), reason)| *reason != "Never" && *a > 0 && *b > 0)
            .map(|((a, b), _)| [LINKS[a], LINKS[b]])
            .collect();
        prop_assert_eq!(pairs(&file, &LINKS[1..]).unwrap(), expected);
    }

    #[test]
    fn no_text_panics(
        text in "(<robot name='arm'>|<disable_collisions |<enable_collisions |link1='base' |link2='tip'|reason='Never'|/>|</robot>|<|>|.){0,12}"
    ) {
        let _ = read(&text, "x", &arm(), &carriers(&LINKS));
    }
}
