//! HTTP server of one page, on the loopback interface.

use crate::PageHost;
use crate::guard::Guard;
use crate::routes::{self, PageResponse};
use crate::state::ServerState;
use hyper::body::Incoming;
use hyper::header::{CACHE_CONTROL, CONNECTION, CONTENT_SECURITY_POLICY, HeaderName, HeaderValue, REFERRER_POLICY};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use pwrfgs_core::{Error, Result};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::{AbortHandle, LocalSet};

/// Maximum number of simultaneous connections with the token; a page needs a few.
const MAX_ADMITTED: usize = 64;
/// Maximum number of simultaneous connections without the token; then the oldest is closed.
const MAX_PENDING: usize = 64;
/// Time limit for the head of a request.
const HEAD_TIMEOUT: Duration = Duration::from_secs(10);
/// Largest head of a request, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Maximum number of headers of a request.
const MAX_HEADERS: usize = 64;
/// Interval between checks of the stop flag.
const TICK: Duration = Duration::from_millis(100);
/// Time without an open page after which the server stops; a reload takes less.
const IDLE_LIMIT: Duration = Duration::from_secs(4);
/// Content security policy: only own scripts, style and data; `blob:` and `data:` are images that the page makes.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data: \
    blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// Policy of a page in a notebook: pages on this machine may show it in a frame, and those of Visual Studio Code.
const FRAMED_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src \
    'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors http://localhost:* http://127.0.0.1:* \
    vscode-webview:";

/// Serves `state` on a free loopback port until `stop` is set or, in a browser, the last page is closed. `ready` receives
/// the address with the token.
///
/// # Errors
/// If the system provides no port or no random numbers.
pub(crate) fn serve(
    state: &Arc<ServerState>,
    host: PageHost,
    ready: impl FnOnce(&str),
    stop: &AtomicBool,
) -> Result<()> {
    let failed = |action: &str, e: &dyn std::fmt::Display| Error::Config(format!("cannot {action}: {e}"));
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
        .map_err(|e| failed("start the server", &e))?;
    let served = LocalSet::new().block_on(&runtime, async {
        let listener =
            TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.map_err(|e| failed("listen on 127.0.0.1", &e))?;
        let port = listener.local_addr().map_err(|e| failed("listen on 127.0.0.1", &e))?.port();
        let is_framed = host == PageHost::Notebook;
        let guard = Guard::new(port, is_framed).map_err(|e| failed("create a random token", &e))?;
        ready(&guard.address());
        let accepting = tokio::task::spawn_local(accept_connections(listener, Arc::new(guard), Arc::clone(state)));
        wait_for_end(state, host, stop).await;
        accepting.abort();
        Ok(())
    });
    runtime.shutdown_background(); // does not wait for a locator that is being fitted
    served
}

/// Waits until `stop` is set or, in a browser, no page has been open for [`IDLE_LIMIT`] after the first one.
async fn wait_for_end(state: &ServerState, host: PageHost, stop: &AtomicBool) {
    let mut idle = Duration::ZERO;
    while !stop.load(Ordering::Relaxed) && idle < IDLE_LIMIT {
        tokio::time::sleep(TICK).await;
        idle = if host == PageHost::Browser && state.is_abandoned() { idle + TICK } else { Duration::ZERO };
    }
}

/// Access of one connection, with a slot among the admitted ones from the first request with the token on.
struct ConnectionAccess {
    guard: Arc<Guard>,
    slots: Arc<Semaphore>,
    permit: RefCell<Option<OwnedSemaphorePermit>>,
}

impl ConnectionAccess {
    /// Returns whether a request with the token was received.
    fn is_admitted(&self) -> bool {
        self.permit.borrow().is_some()
    }

    /// Checks a request and returns the part of its path after the token. The first admitted one acquires the slot.
    ///
    /// # Errors
    /// The guard rejects the request, or no slot is free: the status of the answer.
    fn admit<'r>(&self, request: &'r Request<Incoming>) -> Result<&'r str, StatusCode> {
        let path = self.guard.admit(request.method(), request.uri(), request.headers())?;
        if !self.is_admitted() {
            let permit =
                Arc::clone(&self.slots).try_acquire_owned().map_err(|_full| StatusCode::SERVICE_UNAVAILABLE)?;
            *self.permit.borrow_mut() = Some(permit);
        }
        Ok(path)
    }
}

/// Accepts connections without end. If too many have not sent the token, the oldest of these is closed.
async fn accept_connections(listener: TcpListener, guard: Arc<Guard>, state: Arc<ServerState>) {
    let slots = Arc::new(Semaphore::new(MAX_ADMITTED));
    let mut pending: VecDeque<(Rc<ConnectionAccess>, AbortHandle)> = VecDeque::new();
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Waits until other connections release what is missing, such as file descriptors.
            tokio::time::sleep(TICK).await;
            continue;
        };
        pending.retain(|(access, task)| !access.is_admitted() && !task.is_finished());
        if pending.len() == MAX_PENDING
            && let Some((_, oldest)) = pending.pop_front()
        {
            oldest.abort();
        }
        let (guard, slots) = (Arc::clone(&guard), Arc::clone(&slots));
        let access = Rc::new(ConnectionAccess { guard, slots, permit: RefCell::default() });
        let (task_access, state) = (Rc::clone(&access), Arc::clone(&state));
        let task = tokio::task::spawn_local(async move { serve_connection(stream, &task_access, &state).await });
        pending.push_back((access, task.abort_handle()));
    }
}

/// Serves all requests of one connection. An error ends only this connection.
async fn serve_connection(stream: TcpStream, access: &ConnectionAccess, state: &Arc<ServerState>) {
    _ = stream.set_nodelay(true);
    let service = service_fn(async |request| Ok::<_, Infallible>(respond(request, access, state).await));
    let mut server = http1::Builder::new();
    server
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .max_buf_size(MAX_HEAD_BYTES)
        .max_headers(MAX_HEADERS);
    _ = server.serve_connection(TokioIo::new(stream), service).await;
}

/// Answers one request, or refuses it and closes the connection.
async fn respond(request: Request<Incoming>, access: &ConnectionAccess, state: &Arc<ServerState>) -> PageResponse {
    let answer = match access.admit(&request) {
        Ok(path) => routes::answer(path, request.uri().query().unwrap_or(""), state).await,
        Err(status) => {
            let mut refusal = routes::plain_text_response(status, status.canonical_reason().unwrap_or("refused"));
            refusal.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
            Ok(refusal)
        }
    };
    let answer = answer.unwrap_or_else(|(status, why)| routes::plain_text_response(status, &why));
    with_security_headers(answer, access.guard.is_framed())
}

/// Adds headers to a response, so that no other page can load or store it, or frame it unless `is_framed`.
fn with_security_headers(mut response: PageResponse, is_framed: bool) -> PageResponse {
    let headers = [
        (CONTENT_SECURITY_POLICY, if is_framed { FRAMED_POLICY } else { POLICY }),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("x-content-type-options"), "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ];
    for (name, value) in headers {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}
