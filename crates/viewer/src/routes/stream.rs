//! News of a page: server-sent events, open for as long as somebody looks.

use super::{Body, response};
use crate::house::{House, Watcher};
use http_body_util::BodyExt as _;
use hyper::body::{Body as _, Bytes, Frame};
use hyper::{Response, StatusCode};
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

/// How often something is said, whether there is news or not: so a closed page is found out.
const BEAT: Duration = Duration::from_secs(1);

type Next = Pin<Box<dyn Future<Output = (Option<Bytes>, Receiver<String>)> + Send + Sync>>;

/// News as they come.
struct Stream {
    next: Next,
    _watcher: Watcher,
}

impl hyper::body::Body for Stream {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        match self.next.as_mut().poll(context) {
            Poll::Pending => Poll::Pending,
            Poll::Ready((None, _)) => Poll::Ready(None),
            Poll::Ready((Some(bytes), receiver)) => {
                self.next = next(receiver);
                Poll::Ready(Some(Ok(Frame::data(bytes))))
            }
        }
    }
}

fn next(mut receiver: Receiver<String>) -> Next {
    Box::pin(async move {
        let said = match tokio::time::timeout(BEAT, receiver.recv()).await {
            Ok(Ok(news)) => Some(format!("data: {news}\n\n")),
            Ok(Err(RecvError::Closed)) => None,
            Ok(Err(RecvError::Lagged(_))) | Err(_) => Some(":\n\n".into()),
        };
        (said.map(Bytes::from), receiver)
    })
}

/// The stream of a page that was opened.
pub(super) fn events(house: &Arc<House>) -> Response<Body> {
    let (receiver, watcher) = house.watch();
    let stream = Stream { next: next(receiver), _watcher: watcher };
    debug_assert!(!stream.is_end_stream());
    let mut answer = response(StatusCode::OK, "text/event-stream", Vec::new());
    *answer.body_mut() = stream.boxed();
    answer
}
