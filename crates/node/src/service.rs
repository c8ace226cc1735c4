//! Services and their clients.

use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use dermis_msgs::{Message, Service};

use crate::backend::{
    BackendClient, BackendEndpoint, BackendError, EndpointKind, RawRequest, service_support_of,
};
use crate::error::NodeError;
use crate::executor::{Executor, Lane, lock};
use crate::names::NameKind;
use crate::node::{Close, Core, Registration, runtime};
use crate::watch::OwnEndpoint;

struct ServerInner {
    name: String,
    endpoint: Mutex<Option<Box<dyn BackendEndpoint>>>,
    lane: Arc<Lane<RawRequest>>,
    _registration: Registration,
}

impl Close for ServerInner {
    fn close(&self) {
        let endpoint = lock(&self.endpoint).take();
        drop(endpoint);
        self.lane.close();
    }
}

impl Drop for ServerInner {
    fn drop(&mut self) {
        self.close();
    }
}

/// A served service. It answers until this is dropped or the node is shut down.
#[must_use = "a service that is dropped answers nothing"]
pub struct ServiceServer(Arc<ServerInner>);

impl ServiceServer {
    pub(crate) fn new<S: Service>(
        core: &Arc<Core>,
        executor: &Executor,
        name: &str,
        mut handler: impl FnMut(S::Request) -> S::Response + Send + 'static,
    ) -> Result<Self, NodeError> {
        let name = core.names.resolve(name, NameKind::Service)?;
        core.check_open()?;
        let support = service_support_of::<S>();
        let registration = core.register(OwnEndpoint {
            kind: EndpointKind::Service,
            name: name.clone(),
            type_name: support.name,
            type_hash: support.hash,
            qos: None,
        });
        let service = name.clone();
        let lane = executor.lane(name.clone(), None, move |request: RawRequest| {
            let RawRequest { payload, reply } = request;
            match S::Request::from_cdr(&payload) {
                Ok(message) => {
                    if let Err(error) = reply(&handler(message).to_cdr()) {
                        tracing::warn!("the answer of service {service} was not sent: {error}");
                    }
                }
                Err(source) => {
                    tracing::warn!("{}", NodeError::Decode { name: service.clone(), source });
                }
            }
        });
        let sink = Arc::clone(&lane);
        let endpoint = core.node.serve(&name, &support, Box::new(move |request| sink.push(request)))?;
        let inner = Arc::new(ServerInner {
            name,
            endpoint: Mutex::new(Some(endpoint)),
            lane,
            _registration: registration,
        });
        core.track(&inner);
        Ok(Self(inner))
    }

    /// The full name of the service.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0.name
    }
}

struct ClientInner {
    core: Arc<Core>,
    name: String,
    backend: RwLock<Option<Arc<dyn BackendClient>>>,
    _registration: Registration,
}

impl Close for ClientInner {
    fn close(&self) {
        let backend = self.backend.write().unwrap_or_else(PoisonError::into_inner).take();
        drop(backend);
    }
}

/// A client of a service. Cheap to clone.
pub struct Client<S> {
    inner: Arc<ClientInner>,
    service: PhantomData<fn(S)>,
}

impl<S> Clone for Client<S> {
    fn clone(&self) -> Self {
        Self { inner: Arc::clone(&self.inner), service: PhantomData }
    }
}

impl<S: Service> Client<S> {
    pub(crate) fn new(core: &Arc<Core>, name: &str) -> Result<Self, NodeError> {
        let name = core.names.resolve(name, NameKind::Service)?;
        core.check_open()?;
        let support = service_support_of::<S>();
        let registration = core.register(OwnEndpoint {
            kind: EndpointKind::Client,
            name: name.clone(),
            type_name: support.name,
            type_hash: support.hash,
            qos: None,
        });
        let backend = core.node.client(&name, &support)?;
        let inner = Arc::new(ClientInner {
            core: Arc::clone(core),
            name,
            backend: RwLock::new(Some(backend)),
            _registration: registration,
        });
        core.track(&inner);
        Ok(Self { inner, service: PhantomData })
    }

    /// The full name of the service.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// Whether a server is there.
    #[must_use]
    pub fn available(&self) -> bool {
        self.backend().is_some_and(|backend| backend.available())
    }

    fn backend(&self) -> Option<Arc<dyn BackendClient>> {
        self.inner.backend.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Waits for a server, then calls it, all within `timeout`. May be awaited on any executor.
    ///
    /// # Errors
    ///
    /// When no answer comes in time, or one that does not decode.
    pub async fn call(&self, request: &S::Request, timeout: Duration) -> Result<S::Response, NodeError> {
        let backend = self.backend().ok_or_else(|| self.inner.core.shut_down())?;
        let payload = request.to_cdr();
        let timed_out = |hint| NodeError::Timeout { name: self.inner.name.clone(), timeout, hint };
        // On a runtime of our own, because a timer needs one and the caller may have none.
        let call = runtime()?.spawn(async move {
            let deadline = tokio::time::Instant::now() + timeout;
            while !backend.available() {
                if tokio::time::Instant::now() >= deadline {
                    return Err("no server of that name and type was seen");
                }
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            // The backend gives up a little later, so that the reason given is always the same.
            let patience = timeout.saturating_add(Duration::from_secs(1));
            tokio::time::timeout_at(deadline, backend.call(&payload, patience))
                .await
                .map_err(|_| "a server is there, but did not answer")
        });
        let answer = call.await.map_err(|error| BackendError::NoAnswer {
            name: self.inner.name.clone(),
            reason: error.to_string(),
        })?;
        let bytes = answer.map_err(timed_out)??;
        S::Response::from_cdr(&bytes)
            .map_err(|source| NodeError::Decode { name: self.inner.name.clone(), source })
    }

    /// [`Client::call`] for callers without async. Not for use in a callback of the same node with one
    /// thread, nor inside of an async function.
    ///
    /// # Errors
    ///
    /// When no answer comes in time, or one that does not decode.
    pub fn call_blocking(&self, request: &S::Request, timeout: Duration) -> Result<S::Response, NodeError> {
        futures::executor::block_on(self.call(request, timeout))
    }
}
