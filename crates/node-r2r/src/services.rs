//! Services by name of their type: r2r knows services only by their Rust types.

use bytes::Bytes;
use dermis_node::backend::{BackendError, RawRequest, RequestSink};
use futures::future::BoxFuture;
use futures::{FutureExt, StreamExt};
use r2r::{Error, Node, WrappedServiceTypeSupport, WrappedTypesupport};

use crate::profile;
use crate::worker::{Poll, Server};

/// Makes a server of one type on a node.
type MakeServer = fn(&mut Node, &str, RequestSink) -> Result<Server, Error>;
/// Makes a client of one type on a node.
type MakeClient = fn(&mut Node, &str) -> Result<MadeClient, Error>;
/// Sends an encoded request; the future yields the encoded response.
pub(crate) type Call =
    Box<dyn Fn(&[u8]) -> Result<BoxFuture<'static, Result<Bytes, Error>>, Error> + Send + Sync>;

/// A client, in the two parts that are used from different threads.
pub(crate) struct MadeClient {
    pub call: Call,
    pub poll: Poll,
}

macro_rules! known {
    ($($name:literal => $path:ty),+ $(,)?) => {
        /// How to serve a type; `None` for one that is not known here.
        pub(crate) fn server(name: &str) -> Option<MakeServer> {
            match name { $($name => Some(serve::<$path>),)+ _ => None }
        }

        /// How to call a type; `None` for one that is not known here.
        pub(crate) fn client(name: &str) -> Option<MakeClient> {
            match name { $($name => Some(make_client::<$path>),)+ _ => None }
        }
    };
}

known! {
    "std_srvs/srv/Trigger" => r2r::std_srvs::srv::Trigger::Service,
    "std_srvs/srv/SetBool" => r2r::std_srvs::srv::SetBool::Service,
    "action_msgs/srv/CancelGoal" => r2r::action_msgs::srv::CancelGoal::Service,
    "dermis_msgs/srv/LoadModel" => r2r::dermis_msgs::srv::LoadModel::Service,
    "rcl_interfaces/srv/GetParameters" => r2r::rcl_interfaces::srv::GetParameters::Service,
    "rcl_interfaces/srv/SetParameters" => r2r::rcl_interfaces::srv::SetParameters::Service,
    "rcl_interfaces/srv/SetParametersAtomically" => r2r::rcl_interfaces::srv::SetParametersAtomically::Service,
    "rcl_interfaces/srv/ListParameters" => r2r::rcl_interfaces::srv::ListParameters::Service,
    "rcl_interfaces/srv/DescribeParameters" => r2r::rcl_interfaces::srv::DescribeParameters::Service,
    "rcl_interfaces/srv/GetParameterTypes" => r2r::rcl_interfaces::srv::GetParameterTypes::Service,
    "lifecycle_msgs/srv/ChangeState" => r2r::lifecycle_msgs::srv::ChangeState::Service,
    "lifecycle_msgs/srv/GetState" => r2r::lifecycle_msgs::srv::GetState::Service,
    "lifecycle_msgs/srv/GetAvailableStates" => r2r::lifecycle_msgs::srv::GetAvailableStates::Service,
    "lifecycle_msgs/srv/GetAvailableTransitions" => r2r::lifecycle_msgs::srv::GetAvailableTransitions::Service,
}

fn services() -> r2r::QosProfile {
    profile(&dermis_node::Qos::services())
}

fn serve<T>(node: &mut Node, name: &str, sink: RequestSink) -> Result<Server, Error>
where
    T: WrappedServiceTypeSupport + 'static,
{
    let mut requests = node.create_service::<T>(name, services())?;
    let name = name.to_owned();
    Ok(Box::new(move |wanted| {
        while let Some(Some(request)) = requests.next().now_or_never() {
            if !wanted {
                continue;
            }
            let payload = match request.message.to_serialized_bytes() {
                Ok(bytes) => Bytes::from(bytes),
                Err(e) => {
                    tracing::warn!("a request to {name} is dropped: it does not serialise: {e}");
                    continue;
                }
            };
            let service = name.clone();
            let reply = Box::new(move |response: &[u8]| {
                T::Response::from_serialized_bytes(response)
                    .and_then(|r| request.respond(r))
                    .map_err(|e| BackendError::Send { name: service, reason: e.to_string() })
            });
            sink(RawRequest { payload, reply });
        }
    }))
}

fn make_client<T>(node: &mut Node, name: &str) -> Result<MadeClient, Error>
where
    T: WrappedServiceTypeSupport + 'static,
    T::Response: Send,
{
    let client = std::sync::Arc::new(std::sync::Mutex::new(node.create_client::<T>(name, services())?));
    let watched = std::sync::Arc::clone(&client);
    let call: Call = Box::new(move |request| {
        let request = T::Request::from_serialized_bytes(request)?;
        let answer = crate::lock(&client).request(&request)?;
        Ok(async move { answer.await?.to_serialized_bytes().map(Bytes::from) }.boxed())
    });
    let poll: Poll = Box::new(move || {
        let there = Node::is_available(&*crate::lock(&watched)).ok()?;
        Some(
            async move {
                // An error means that the node is gone; then nobody waits here any more.
                if there.await.is_err() {
                    futures::future::pending::<()>().await;
                }
            }
            .boxed(),
        )
    });
    Ok(MadeClient { call, poll })
}
