//! Services and their clients: a request is a zenoh query, an answer its reply.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use futures::FutureExt;
use futures::future::BoxFuture;
use hiroz::attachment::{Attachment, GidArray};
use hiroz::entity::{EndpointKind as GraphKind, TypeInfo};
use hiroz::graph::Graph;
use zenoh::Wait;
use zenoh::query::{ConsolidationMode, Querier, Query, QueryTarget};

use super::{has_type, off_runtime};
use crate::backend::{BackendClient, BackendEndpoint, BackendError, RawRequest};
use crate::executor::lock;

/// A request, with the function that answers its caller.
pub(super) fn raw_request(service: &str, query: Query) -> RawRequest {
    // A plain zenoh client may call without an attachment; it does not look for one in the answer.
    let (sequence, gid) = query
        .attachment()
        .and_then(|bytes| Attachment::try_from(bytes).ok())
        .map_or((0, GidArray::default()), |a| (a.sequence_number, a.source_gid));
    let payload =
        query.payload().map_or_else(Bytes::new, |payload| Bytes::from(payload.to_bytes().into_owned()));
    let service = service.to_owned();
    RawRequest {
        payload,
        reply: Box::new(move |bytes| {
            let key = query.key_expr().clone();
            off_runtime(|| query.reply(key, bytes).attachment(Attachment::new(sequence, gid)).wait())
                .map_err(|error| BackendError::Send { name: service, reason: error.to_string() })
        }),
    }
}

/// Withdraws the service when it is dropped.
pub(super) struct HirozServer(pub(super) Option<Box<dyn std::any::Any + Send + Sync>>);

impl BackendEndpoint for HirozServer {}

impl Drop for HirozServer {
    fn drop(&mut self) {
        let server = self.0.take();
        off_runtime(|| drop(server));
    }
}

/// A client; it finds its server in the graph, and asks zenoh whether queries reach it.
pub(super) struct HirozClient {
    pub(super) name: String,
    /// Announces the client in the graph.
    pub(super) presence: Option<Box<dyn std::any::Any + Send + Sync>>,
    pub(super) type_info: TypeInfo,
    pub(super) gid: GidArray,
    /// Knows the key, and whether a query would reach a server. Taken out when the client is dropped.
    pub(super) querier: Option<Querier<'static>>,
    /// Taken out when the client is dropped.
    pub(super) session: Option<Arc<zenoh::Session>>,
    pub(super) graph: Arc<Graph>,
    pub(super) sequence: AtomicI64,
}

impl BackendClient for HirozClient {
    fn available(&self) -> bool {
        let seen = self
            .graph
            .get_entities_by_service(GraphKind::Service, &self.name)
            .iter()
            .any(|entity| has_type(entity, &self.type_info));
        // The graph may show a server before queries are routed to it. Zenoh looks into its tables, without waiting.
        seen && self.querier.as_ref().is_some_and(|querier| {
            let status = querier.matching_status().into_future().now_or_never();
            status.and_then(Result::ok).is_some_and(|status| status.matching())
        })
    }

    fn call(&self, request: &[u8], timeout: Duration) -> BoxFuture<'static, Result<Bytes, BackendError>> {
        let name = self.name.clone();
        let no_answer = move |reason: String| BackendError::NoAnswer { name, reason };
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let (answer, answered) = futures::channel::oneshot::channel();
        let answer = Mutex::new(Some(answer));
        let (Some(session), Some(querier)) = (&self.session, &self.querier) else {
            return std::future::ready(Err(no_answer("the client is closed".to_owned()))).boxed();
        };
        let sent = session
            .get(querier.key_expr())
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(timeout)
            .payload(request)
            .attachment(Attachment::new(sequence, self.gid))
            .callback(move |reply| {
                if let Ok(sample) = reply.into_result()
                    && let Some(answer) = lock(&answer).take()
                {
                    // The caller may have given up.
                    let _ = answer.send(Bytes::from(sample.payload().to_bytes().into_owned()));
                }
            })
            .wait();
        async move {
            match sent {
                Ok(()) => {
                    answered.await.map_err(|_| no_answer("the server ended the call without one".to_owned()))
                }
                Err(error) => Err(no_answer(error.to_string())),
            }
        }
        .boxed()
    }
}

impl Drop for HirozClient {
    fn drop(&mut self) {
        let (querier, presence, session) = (self.querier.take(), self.presence.take(), self.session.take());
        off_runtime(|| drop((querier, presence, session)));
    }
}
