//! Every message type, for what needs the type itself.

use std::sync::OnceLock;

use dermis_msgs::{Message, TypeSupport};
use dermis_transport::framing::CRC_16;

/// A message type, and what must hold for any bytes that it decodes.
pub struct Kind {
    /// The type as a tool has it that knows only its name.
    pub support: &'static TypeSupport,
    /// What decodes must encode to bytes that decode, and encode to themselves.
    pub round_trip: fn(&[u8]),
}

fn kind<T: Message>() -> Kind {
    Kind { support: TypeSupport::of::<T>(), round_trip: round_trip::<T> }
}

fn round_trip<T: Message>(bytes: &[u8]) {
    let Ok(message) = T::from_cdr(bytes) else { return };
    let encoded = message.to_cdr();
    match T::from_cdr(&encoded) {
        Ok(again) => assert_eq!(again.to_cdr(), encoded, "{} changes on its way", T::TYPE_NAME),
        Err(error) => panic!("what was encoded does not decode: {error}"),
    }
}

/// The number that a type has in front of fuzzed bytes. It depends on the name only, so that a corpus outlives new types.
pub fn selector(name: &str) -> u16 {
    CRC_16.checksum(name.as_bytes())
}

/// Splits fuzzed bytes into the type that they select, the next of those that exist, and what is left.
pub fn select(data: &[u8]) -> Option<(&'static Kind, &[u8])> {
    let (&chosen, rest) = data.split_first_chunk()?;
    let chosen = u16::from_le_bytes(chosen);
    let kinds = kinds();
    let at = kinds.partition_point(|k| selector(k.support.name) < chosen);
    kinds.get(at).or(kinds.first()).map(|kind| (kind, rest))
}

/// Every type, in order of its selector.
pub fn kinds() -> &'static [Kind] {
    static KINDS: OnceLock<Vec<Kind>> = OnceLock::new();
    KINDS.get_or_init(|| {
        let mut kinds = all();
        kinds.sort_by_key(|k| selector(k.support.name));
        kinds
    })
}

fn all() -> Vec<Kind> {
    let mut kinds = own();
    kinds.extend(of_bodies());
    kinds.extend(of_nodes());
    kinds.extend(of_sensors_and_others());
    kinds
}

/// Actions, times, and the messages of dermis.
fn own() -> Vec<Kind> {
    vec![
        kind::<dermis_msgs::action_msgs::msg::GoalInfo>(),
        kind::<dermis_msgs::action_msgs::srv::CancelGoalRequest>(),
        kind::<dermis_msgs::action_msgs::srv::CancelGoalResponse>(),
        kind::<dermis_msgs::builtin_interfaces::msg::Duration>(),
        kind::<dermis_msgs::builtin_interfaces::msg::Time>(),
        kind::<dermis_msgs::msg::BodyContact>(),
        kind::<dermis_msgs::msg::BodyContacts>(),
        kind::<dermis_msgs::msg::Contact>(),
        kind::<dermis_msgs::msg::ContactArray>(),
        kind::<dermis_msgs::msg::DisplacementMap>(),
        kind::<dermis_msgs::msg::ForceMap>(),
        kind::<dermis_msgs::msg::Indentation>(),
        kind::<dermis_msgs::msg::IndentationContact>(),
        kind::<dermis_msgs::msg::LinkWrench>(),
        kind::<dermis_msgs::msg::SkinGeometry>(),
        kind::<dermis_msgs::msg::SkinHealth>(),
        kind::<dermis_msgs::msg::TaxelFrame>(),
        kind::<dermis_msgs::srv::LoadModelRequest>(),
        kind::<dermis_msgs::srv::LoadModelResponse>(),
    ]
}

/// Diagnostics and geometry.
fn of_bodies() -> Vec<Kind> {
    vec![
        kind::<dermis_msgs::diagnostic_msgs::msg::DiagnosticArray>(),
        kind::<dermis_msgs::diagnostic_msgs::msg::DiagnosticStatus>(),
        kind::<dermis_msgs::diagnostic_msgs::msg::KeyValue>(),
        kind::<dermis_msgs::geometry_msgs::msg::Point>(),
        kind::<dermis_msgs::geometry_msgs::msg::Point32>(),
        kind::<dermis_msgs::geometry_msgs::msg::PointStamped>(),
        kind::<dermis_msgs::geometry_msgs::msg::Pose>(),
        kind::<dermis_msgs::geometry_msgs::msg::PoseStamped>(),
        kind::<dermis_msgs::geometry_msgs::msg::Quaternion>(),
        kind::<dermis_msgs::geometry_msgs::msg::Transform>(),
        kind::<dermis_msgs::geometry_msgs::msg::TransformStamped>(),
        kind::<dermis_msgs::geometry_msgs::msg::Twist>(),
        kind::<dermis_msgs::geometry_msgs::msg::TwistStamped>(),
        kind::<dermis_msgs::geometry_msgs::msg::Vector3>(),
        kind::<dermis_msgs::geometry_msgs::msg::Vector3Stamped>(),
        kind::<dermis_msgs::geometry_msgs::msg::Wrench>(),
        kind::<dermis_msgs::geometry_msgs::msg::WrenchStamped>(),
    ]
}

/// Lifecycle and parameters.
fn of_nodes() -> Vec<Kind> {
    vec![
        kind::<dermis_msgs::lifecycle_msgs::msg::State>(),
        kind::<dermis_msgs::lifecycle_msgs::msg::Transition>(),
        kind::<dermis_msgs::lifecycle_msgs::msg::TransitionDescription>(),
        kind::<dermis_msgs::lifecycle_msgs::msg::TransitionEvent>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::ChangeStateRequest>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::ChangeStateResponse>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::GetAvailableStatesRequest>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::GetAvailableStatesResponse>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::GetAvailableTransitionsRequest>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::GetAvailableTransitionsResponse>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::GetStateRequest>(),
        kind::<dermis_msgs::lifecycle_msgs::srv::GetStateResponse>(),
        kind::<dermis_msgs::rcl_interfaces::msg::FloatingPointRange>(),
        kind::<dermis_msgs::rcl_interfaces::msg::IntegerRange>(),
        kind::<dermis_msgs::rcl_interfaces::msg::ListParametersResult>(),
        kind::<dermis_msgs::rcl_interfaces::msg::Log>(),
        kind::<dermis_msgs::rcl_interfaces::msg::Parameter>(),
        kind::<dermis_msgs::rcl_interfaces::msg::ParameterDescriptor>(),
        kind::<dermis_msgs::rcl_interfaces::msg::ParameterEvent>(),
        kind::<dermis_msgs::rcl_interfaces::msg::ParameterType>(),
        kind::<dermis_msgs::rcl_interfaces::msg::ParameterValue>(),
        kind::<dermis_msgs::rcl_interfaces::msg::SetParametersResult>(),
        kind::<dermis_msgs::rcl_interfaces::srv::DescribeParametersRequest>(),
        kind::<dermis_msgs::rcl_interfaces::srv::DescribeParametersResponse>(),
        kind::<dermis_msgs::rcl_interfaces::srv::GetParameterTypesRequest>(),
        kind::<dermis_msgs::rcl_interfaces::srv::GetParameterTypesResponse>(),
        kind::<dermis_msgs::rcl_interfaces::srv::GetParametersRequest>(),
        kind::<dermis_msgs::rcl_interfaces::srv::GetParametersResponse>(),
        kind::<dermis_msgs::rcl_interfaces::srv::ListParametersRequest>(),
        kind::<dermis_msgs::rcl_interfaces::srv::ListParametersResponse>(),
        kind::<dermis_msgs::rcl_interfaces::srv::SetParametersAtomicallyRequest>(),
        kind::<dermis_msgs::rcl_interfaces::srv::SetParametersAtomicallyResponse>(),
        kind::<dermis_msgs::rcl_interfaces::srv::SetParametersRequest>(),
        kind::<dermis_msgs::rcl_interfaces::srv::SetParametersResponse>(),
    ]
}

/// Time, sensors, plain values, transforms and markers.
fn of_sensors_and_others() -> Vec<Kind> {
    vec![
        kind::<dermis_msgs::rosgraph_msgs::msg::Clock>(),
        kind::<dermis_msgs::sensor_msgs::msg::CameraInfo>(),
        kind::<dermis_msgs::sensor_msgs::msg::CompressedImage>(),
        kind::<dermis_msgs::sensor_msgs::msg::Image>(),
        kind::<dermis_msgs::sensor_msgs::msg::Imu>(),
        kind::<dermis_msgs::sensor_msgs::msg::JointState>(),
        kind::<dermis_msgs::sensor_msgs::msg::PointCloud2>(),
        kind::<dermis_msgs::sensor_msgs::msg::PointField>(),
        kind::<dermis_msgs::sensor_msgs::msg::RegionOfInterest>(),
        kind::<dermis_msgs::service_msgs::msg::ServiceEventInfo>(),
        kind::<dermis_msgs::std_msgs::msg::Bool>(),
        kind::<dermis_msgs::std_msgs::msg::ColorRGBA>(),
        kind::<dermis_msgs::std_msgs::msg::Empty>(),
        kind::<dermis_msgs::std_msgs::msg::Float32>(),
        kind::<dermis_msgs::std_msgs::msg::Float64>(),
        kind::<dermis_msgs::std_msgs::msg::Header>(),
        kind::<dermis_msgs::std_msgs::msg::Int32>(),
        kind::<dermis_msgs::std_msgs::msg::String>(),
        kind::<dermis_msgs::std_msgs::msg::UInt8>(),
        kind::<dermis_msgs::std_srvs::srv::SetBoolRequest>(),
        kind::<dermis_msgs::std_srvs::srv::SetBoolResponse>(),
        kind::<dermis_msgs::std_srvs::srv::TriggerRequest>(),
        kind::<dermis_msgs::std_srvs::srv::TriggerResponse>(),
        kind::<dermis_msgs::tf2_msgs::msg::TFMessage>(),
        kind::<dermis_msgs::unique_identifier_msgs::msg::UUID>(),
        kind::<dermis_msgs::visualization_msgs::msg::Marker>(),
        kind::<dermis_msgs::visualization_msgs::msg::MarkerArray>(),
        kind::<dermis_msgs::visualization_msgs::msg::MeshFile>(),
        kind::<dermis_msgs::visualization_msgs::msg::UVCoordinate>(),
    ]
}
