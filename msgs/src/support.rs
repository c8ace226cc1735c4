//! What a message or service type must offer to be sent, and how a program finds a type that it knows only by
//! its name.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::cdr::{self, Cdr, CdrError, CdrErrorKind};

/// A ROS 2 message.
///
/// Only text makes types that implement it: see the [crate]'s documentation.
pub trait Message:
    Cdr + Serialize + DeserializeOwned + Clone + Default + PartialEq + std::fmt::Debug + Send + Sync + 'static
{
    /// Full name: `dermis_msgs/msg/ContactArray`.
    const TYPE_NAME: &'static str;
    /// RIHS01 hash of the type description: `RIHS01_` and 64 hexadecimal digits. Peers whose hash differs do not match.
    const TYPE_HASH: &'static str;
    /// The `.msg` text and that of every type it refers to, as a `ros2msg` schema of MCAP has it.
    const DEFINITION: &'static str;

    /// Little-endian CDR behind its encapsulation header `00 01 00 00`.
    fn to_cdr(&self) -> Vec<u8> {
        cdr::encode(self, Vec::new())
    }

    /// [`to_cdr`](Self::to_cdr) into a buffer that is used again. What it held is lost.
    fn to_cdr_in(&self, buffer: &mut Vec<u8>) {
        *buffer = cdr::encode(self, std::mem::take(buffer));
    }

    /// Reads CDR of either byte order.
    ///
    /// # Errors
    /// Where the bytes are not a message of this type. Padding may follow it: peers append up to as many bytes as the
    /// message has, and 3 more.
    fn from_cdr(bytes: &[u8]) -> Result<Self, CdrError> {
        cdr::decode(bytes).map_err(|kind| CdrError { type_name: Self::TYPE_NAME, kind })
    }
}

/// A ROS 2 service.
pub trait Service: 'static {
    /// Full name: `std_srvs/srv/Trigger`.
    const TYPE_NAME: &'static str;
    /// RIHS01 hash of the type description: `RIHS01_` and 64 hexadecimal digits.
    const TYPE_HASH: &'static str;
    /// What a client sends.
    type Request: Message;
    /// What a server answers.
    type Response: Message;
}

/// What a tool needs of a message type that it knows only by name.
#[derive(Debug)]
pub struct TypeSupport {
    /// [`Message::TYPE_NAME`].
    pub name: &'static str,
    /// [`Message::TYPE_HASH`].
    pub hash: &'static str,
    /// [`Message::DEFINITION`].
    pub definition: &'static str,
    /// CDR to JSON, NaN to `null`.
    pub cdr_to_json: fn(&[u8]) -> Result<Value, CdrError>,
    /// JSON to CDR, `null` to NaN where a number is expected. Fields that are left away take their default.
    pub json_to_cdr: fn(&Value) -> Result<Vec<u8>, CdrError>,
}

impl TypeSupport {
    /// The support of a message type that is known at compile time.
    pub fn of<T: Message>() -> &'static Self {
        const { &Self::new::<T>() }
    }

    pub(crate) const fn new<T: Message>() -> Self {
        Self {
            name: T::TYPE_NAME,
            hash: T::TYPE_HASH,
            definition: T::DEFINITION,
            cdr_to_json: cdr_to_json::<T>,
            json_to_cdr: json_to_cdr::<T>,
        }
    }
}

/// What a tool needs of a service type that it knows only by name.
#[derive(Debug)]
pub struct ServiceSupport {
    /// [`Service::TYPE_NAME`].
    pub name: &'static str,
    /// [`Service::TYPE_HASH`].
    pub hash: &'static str,
    /// Support of the request.
    pub request: &'static TypeSupport,
    /// Support of the response.
    pub response: &'static TypeSupport,
}

impl ServiceSupport {
    pub(crate) const fn new<S: Service>() -> Self {
        Self {
            name: S::TYPE_NAME,
            hash: S::TYPE_HASH,
            request: const { &TypeSupport::new::<S::Request>() },
            response: const { &TypeSupport::new::<S::Response>() },
        }
    }
}

/// The support of every message, requests and responses of services included, in order of name.
pub fn type_supports() -> &'static [TypeSupport] {
    crate::MESSAGES
}

/// The support of every service, in order of name.
pub fn service_supports() -> &'static [ServiceSupport] {
    crate::SERVICES
}

/// The support of a message by its full name, as `dermis_msgs/msg/ContactArray`.
pub fn type_support(name: &str) -> Option<&'static TypeSupport> {
    let all = type_supports();
    all.binary_search_by(|support| support.name.cmp(name)).ok().map(|i| &all[i])
}

/// The support of a service by its full name, as `std_srvs/srv/Trigger`.
pub fn service_support(name: &str) -> Option<&'static ServiceSupport> {
    let all = service_supports();
    all.binary_search_by(|support| support.name.cmp(name)).ok().map(|i| &all[i])
}

fn cdr_to_json<T: Message>(bytes: &[u8]) -> Result<Value, CdrError> {
    let message = T::from_cdr(bytes)?;
    serde_json::to_value(&message).map_err(|e| json_error::<T>(".", &e))
}

fn json_to_cdr<T: Message>(value: &Value) -> Result<Vec<u8>, CdrError> {
    match serde_path_to_error::deserialize::<_, T>(value) {
        Ok(message) => Ok(message.to_cdr()),
        Err(e) => Err(json_error::<T>(&e.path().to_string(), e.inner())),
    }
}

fn json_error<T: Message>(path: &str, problem: &serde_json::Error) -> CdrError {
    let kind = CdrErrorKind::Json { path: path.to_owned(), problem: problem.to_string() };
    CdrError { type_name: T::TYPE_NAME, kind }
}
