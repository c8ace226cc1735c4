//! Says in one sentence which package is missing, where the compiler would say it once for each of its types.

use std::path::Path;

/// Packages whose services this crate names. r2r builds without any of them.
const PACKAGES: [&str; 4] = ["dermis_msgs", "lifecycle_msgs", "rcl_interfaces", "std_srvs"];

fn main() {
    println!("cargo::rerun-if-env-changed=AMENT_PREFIX_PATH");
    let prefixes = std::env::var("AMENT_PREFIX_PATH").unwrap_or_default();
    for package in PACKAGES {
        if prefixes.split(':').any(|prefix| Path::new(prefix).join("share").join(package).is_dir()) {
            continue;
        }
        let what = if package == "dermis_msgs" {
            "build it from msgs/ (`colcon build --paths msgs`) and source its install/setup.sh"
        } else {
            "install it"
        };
        println!("cargo::error=ROS 2 package {package} is not in AMENT_PREFIX_PATH ({prefixes}): {what}");
    }
}
