//! Answers to the page: its files, arrays, and a stream of events.

mod bundles;
mod comparison;

use crate::state::{ServerState, WatcherGuard};
use http_body_util::combinators::BoxBody;
use http_body_util::{BodyExt as _, Full};
use hyper::body::{Body as _, Bytes, Frame};
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::{Response, StatusCode};
use pwrfgs_core::coordinate_fault;
use pwrfgs_core::messages::quoted;
use pwrfgs_report::canvas::escape_xml;
use pwrfgs_report::live::{FILES, PAGE_STYLE, STAGE, STYLE};
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

/// Response of the server.
pub(crate) type PageResponse = Response<BoxBody<Bytes, Infallible>>;

/// Status and message of a rejected request.
pub(crate) type RequestError = (StatusCode, String);

/// Answers a request for `path`, the part after the token: a file of the page, its events, or arrays.
///
/// # Errors
/// If the path or a query parameter is invalid, or the arrays cannot be created.
pub(crate) async fn answer(path: &str, query: &str, state: &Arc<ServerState>) -> Result<PageResponse, RequestError> {
    if let Some((_, text)) = FILES.iter().find(|(name, _)| *name == path) {
        return Ok(text_response("text/javascript", text));
    }
    match path {
        "" => return Ok(text_response("text/html", &page_html(state))),
        "stage.css" => return Ok(text_response("text/css", STYLE)),
        "page.css" => return Ok(text_response("text/css", PAGE_STYLE)),
        "events" => return Ok(event_response(state)),
        _ => {}
    }
    let parameters = QueryParams::parse(query).map_err(|why| (StatusCode::BAD_REQUEST, why))?;
    let (path, state) = (path.to_owned(), Arc::clone(state));
    let result = tokio::task::spawn_blocking(move || bundles::create_bundle(&path, &parameters, &state)).await;
    let bundle = result.map_err(|e| (StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))??;
    Ok(bytes_response(StatusCode::OK, "application/octet-stream", bundle.to_bytes()))
}

/// Creates a response of plain text.
pub(crate) fn plain_text_response(status: StatusCode, text: &str) -> PageResponse {
    bytes_response(status, "text/plain; charset=utf-8", format!("{text}\n").into_bytes())
}

/// Creates the response with a text file of the page; `kind` is its media type.
fn text_response(kind: &str, text: &str) -> PageResponse {
    bytes_response(StatusCode::OK, &format!("{kind}; charset=utf-8"), text.as_bytes().to_vec())
}

/// Creates a response with this status, content type `kind` and body.
fn bytes_response(status: StatusCode, kind: &str, bytes: Vec<u8>) -> PageResponse {
    let mut response = Response::new(Full::new(Bytes::from(bytes)).boxed());
    *response.status_mut() = status;
    if let Ok(kind) = HeaderValue::from_str(kind) {
        response.headers_mut().insert(CONTENT_TYPE, kind);
    }
    response
}

/// Formats the HTML of the page: the stage and its scripts.
fn page_html(state: &ServerState) -> String {
    let names: Vec<String> = state.sides.iter().map(|side| escape_xml(&side.name)).collect();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>{} · pwrfgs view</title>\n<link rel=\"icon\" href=\"data:,\">\n\
         <link rel=\"stylesheet\" href=\"page.css\">\n<link rel=\"stylesheet\" \
         href=\"stage.css\">\n<script type=\"module\" src=\"stage.js\"></script>\n</head>\n<body>\n<main \
         data-source=\"server\">\n{STAGE}\n</main>\n</body>\n</html>\n",
        names.join(" | ")
    )
}

/// Query parameters of a request.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct QueryParams {
    pub(super) side: usize,
    pub(super) receiver: usize,
    /// Transmitter position in metres, world frame.
    pub(super) tx: Option<[f64; 3]>,
    /// Index of a link of the data.
    pub(super) link: Option<usize>,
    /// Index of a snapshot of the training.
    pub(super) snapshot: Option<usize>,
    /// Height of the map plane in metres, world frame.
    pub(super) z: Option<f64>,
    /// Additional array, such as `contribution`.
    pub(super) with: String,
}

impl QueryParams {
    /// Parses `side=0&tx=1,2,3`.
    ///
    /// # Errors
    /// If a parameter is unknown or invalid; the message names it.
    pub(super) fn parse(query: &str) -> Result<Self, String> {
        let mut parameters = Self::default();
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            let (name, value) = pair.split_once('=').ok_or_else(|| format!("query parameter `{pair}`: no value"))?;
            let index = || value.parse::<usize>().map_err(|e| format!("query parameter `{name}`: {e}"));
            match name {
                "side" => parameters.side = index()?,
                "receiver" => parameters.receiver = index()?,
                "link" => parameters.link = Some(index()?),
                "snapshot" => parameters.snapshot = Some(index()?),
                "z" => parameters.z = Some(parse_metres(name, value)?),
                "tx" => {
                    let numbers: Vec<f64> =
                        value.split(',').map(|v| parse_metres(name, v)).collect::<Result<_, _>>()?;
                    parameters.tx = Some(numbers.try_into().map_err(|numbers: Vec<f64>| {
                        format!("query parameter `tx`: expected x,y,z, found {} numbers", numbers.len())
                    })?);
                }
                "with" => value.clone_into(&mut parameters.with),
                _ => return Err(format!("unknown query parameter `{name}`")),
            }
        }
        Ok(parameters)
    }
}

/// Parses the query parameter `name`, metres. Returns an error, which names it, for text or an invalid coordinate.
fn parse_metres(name: &str, value: &str) -> Result<f64, String> {
    let Ok(number) = value.parse() else {
        return Err(format!("query parameter `{name}`: expected metres, found {}", quoted(value)));
    };
    coordinate_fault(number).map_or(Ok(number), |fault| Err(format!("query parameter `{name}` {fault}")))
}

/// Interval of events; an empty event detects a closed page.
const EVENT_INTERVAL: Duration = Duration::from_secs(1);

/// Next event, `None` at the end of the stream, with the receiver.
type PendingEvent = Pin<Box<dyn Future<Output = (Option<Bytes>, Receiver<String>)> + Send + Sync>>;

/// Stream of events.
struct Stream {
    next: PendingEvent,
    _watcher: WatcherGuard,
}

impl hyper::body::Body for Stream {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        match self.next.as_mut().poll(cx) {
            Poll::Pending => Poll::Pending,
            Poll::Ready((None, _)) => Poll::Ready(None),
            Poll::Ready((Some(bytes), receiver)) => {
                self.next = next_event(receiver);
                Poll::Ready(Some(Ok(Frame::data(bytes))))
            }
        }
    }
}

/// Waits for the next message, at most for [`EVENT_INTERVAL`]; an empty event then follows. Returns `None` at the end
/// of the stream, and always the receiver.
fn next_event(mut receiver: Receiver<String>) -> PendingEvent {
    Box::pin(async move {
        let message = match tokio::time::timeout(EVENT_INTERVAL, receiver.recv()).await {
            Ok(Ok(event)) => Some(format!("data: {event}\n\n")),
            Ok(Err(RecvError::Closed)) => None,
            Ok(Err(RecvError::Lagged(_))) | Err(_) => Some(":\n\n".into()),
        };
        (message.map(Bytes::from), receiver)
    })
}

/// Creates the response with the event stream of an opened page, which is registered until the stream is dropped.
fn event_response(state: &Arc<ServerState>) -> PageResponse {
    let (receiver, watcher) = state.register_page();
    let stream = Stream { next: next_event(receiver), _watcher: watcher };
    debug_assert!(!stream.is_end_stream());
    let mut answer = bytes_response(StatusCode::OK, "text/event-stream", Vec::new());
    *answer.body_mut() = stream.boxed();
    answer
}

#[cfg(test)]
mod tests {
    use super::QueryParams;

    #[test]
    fn parses_queries_and_rejects_invalid_ones() {
        let parameters = QueryParams::parse("side=1&tx=1,-2.5,3e0&with=strength").unwrap();
        assert_eq!((parameters.side, parameters.tx, parameters.with.as_str()), (1, Some([1.0, -2.5, 3.0]), "strength"));
        assert_eq!(QueryParams::parse("").unwrap(), QueryParams::default());
        for wrong in ["tx=1,2", "tx=1,2,nan", "tx=1,2,inf", "tx=1,2,1e30", "side=-1", "side", "link=x", "z=", "other=1"]
        {
            assert!(QueryParams::parse(wrong).is_err(), "{wrong}");
        }
    }
}
