//! A hand with a pad in it, pressed by a simulated device while its wrist turns.

/// The pad in the palm.
pub const ROBOT: &str = "schema = 'dermis-robot/1'\nname = 'one'\nurdf = 'one.urdf'\n\
    [[skins]]\nname = 'palm'\nnamespace = '/one/palm'\ntimeout = 0.5\n\
    mount = { parent = 'hand', translation = [0.1, 0.0, 0.02], rpy = [0.0, 1.5707963267948966, 0.0] }\n";
/// Pressed again and again, with what a tare takes in between.
pub const PLAN: &str = "schema = 'dermis-plan/1'\nname = 'pressed'\nseed = 1\ndiameter = 0.004\nmargin = 0.006\n\
                    [timing]\napproach = [0.05, 0.1]\nload = [0.1, 0.1]\nhold = [0.5, 0.5]\nunload = [0.1, 0.1]\n\
                    gap = [1.0, 1.0]\n[[steps]]\nkind = 'idle'\nduration = 2.0\n\
                    [[steps]]\nkind = 'presses'\ncount = 200\nforce = [0.8, 1.2]\n";
/// A hand that turns about a wrist.
pub const URDF: &str = r#"<robot name="one"><link name="base"/><link name="hand"/>
    <joint name="wrist" type="revolute"><parent link="base"/><child link="hand"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
      <limit lower="-3" upper="3" velocity="1" effort="1"/></joint></robot>"#;
