//! ROS 2 messages of dermis: Rust types made from `.msg` and `.srv` text, their CDR encoding and type hashes.
//!
//! The text in `msg/` and `srv/` is an ament package that colcon builds for C, C++ and Python. The build script of
//! this crate reads the same text, and that of the standard packages it builds on (`std/`), and makes the types here;
//! no ROS installation is needed. Packages are modules: [`msg::ContactArray`] is `dermis_msgs/msg/ContactArray`,
//! [`std_msgs::msg::Header`] is `std_msgs/msg/Header`, [`std_srvs::srv::Trigger`] is `std_srvs/srv/Trigger`.
//!
//! ```
//! use dermis_msgs::geometry_msgs::msg::{Point, Vector3};
//! use dermis_msgs::msg::{Contact, ContactArray};
//! use dermis_msgs::std_msgs::msg::Header;
//! use dermis_msgs::{Message, TypeSupport};
//!
//! // A finger pushes into the skin with 2 N.
//! let contacts = ContactArray {
//!     header: Header::new(1_700_000_000_000_000_000, "palm_skin"),
//!     skin: "palm".to_owned(),
//!     sequence: 1,
//!     status: ContactArray::STATUS_OK,
//!     sensor_kind: ContactArray::KIND_REAL,
//!     force_threshold: 0.05,
//!     force_max: f32::NAN,
//!     contacts: vec![Contact {
//!         track_id: 1,
//!         position: Point { x: 0.012, y: -0.004, z: 0.0 },
//!         normal: Vector3 { x: 0.0, y: 0.0, z: 1.0 },
//!         force: Vector3 { x: 0.0, y: 0.0, z: -2.0 },
//!         force_components: Contact::FORCE_NORMAL,
//!         confidence: 0.98,
//!         ..Contact::default()
//!     }],
//!     ..ContactArray::default()
//! };
//!
//! // The same bytes go to ROS 2, to zenoh and into a bag.
//! let bytes = contacts.to_cdr();
//! assert_eq!(ContactArray::from_cdr(&bytes)?.contacts, contacts.contacts);
//!
//! // A type that is known by its name only, as from a bag: JSON and back.
//! let support = dermis_msgs::type_support("dermis_msgs/msg/ContactArray").ok_or("no such message")?;
//! assert_eq!(support.hash, TypeSupport::of::<ContactArray>().hash);
//! let json = (support.cdr_to_json)(&bytes)?;
//! assert_eq!(json["contacts"][0]["force"]["z"], -2.0);
//! assert_eq!(json["force_max"], serde_json::Value::Null); // NaN: unknown
//! assert_eq!((support.json_to_cdr)(&json)?, bytes);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # How text becomes Rust
//!
//! | text | Rust |
//! |---|---|
//! | `bool`, `byte`, `char`, `uint8` … `float64` | `bool`, `u8`, `u8`, `u8` … `f64` |
//! | `string` | `String` |
//! | `T[]`, `T[<=9]` | `Vec<T>` |
//! | `T[9]` | `[T; 9]` |
//! | `pkg/Type` | `dermis_msgs::pkg::msg::Type` |
//! | `uint8 STATUS_OK=0` | `ContactArray::STATUS_OK: u8` |
//! | a field named by a keyword, as `type` | `r#type` |
//! | `float64 w 1` | `Default` makes it 1.0; without a value 0, false or empty |
//! | a service `Trigger` | [`Service`] `Trigger` with `TriggerRequest` and `TriggerResponse` |
//!
//! A bound (`T[<=9]`, `string<=9`) is checked when bytes are read. A peer refuses a message that is beyond it.

pub mod cdr;
mod json;
mod layout;
pub mod sequence;
mod skin;
mod status;
mod support;
mod time;
mod truth;
pub mod v0;

pub use cdr::{CdrError, CdrErrorKind};
pub use layout::ChannelLayout;
pub use skin::{OF_A_SKIN, SkinNames};
pub use support::{
    Message, Service, ServiceSupport, TypeSupport, service_support, service_supports, type_support,
    type_supports,
};

include!(concat!(env!("OUT_DIR"), "/interfaces.rs"));
