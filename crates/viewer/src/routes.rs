//! What the page asks for, and what it is given.

mod asked;
mod packs;
mod stream;

use crate::house::House;
use asked::Asked;
use http_body_util::{BodyExt as _, Full, combinators::BoxBody};
use hyper::body::Bytes;
use hyper::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, HeaderValue, REFERRER_POLICY};
use hyper::{Response, StatusCode};
use pwrfgs_report::live::{FILES, STYLE};
use std::convert::Infallible;
use std::sync::Arc;

pub(crate) type Body = BoxBody<Bytes, Infallible>;

/// A status and a sentence.
pub(crate) type Refusal = (StatusCode, String);

/// Nothing but our own scripts, style and data; `blob:` and `data:` are pictures that the page makes.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data: \
    blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The answer to `path`, behind the token.
pub(crate) async fn answer(path: &str, query: &str, house: &Arc<House>) -> Result<Response<Body>, Refusal> {
    if let Some((_, text)) = FILES.iter().find(|(name, _)| *name == path) {
        return Ok(text_of("text/javascript", text));
    }
    match path {
        "" => return Ok(text_of("text/html", &crate::page::html(house))),
        "stage.css" => return Ok(text_of("text/css", STYLE)),
        "view.css" => return Ok(text_of("text/css", crate::page::STYLE)),
        "events" => return Ok(stream::events(house)),
        _ => {}
    }
    let asked = Asked::parse(query).map_err(|why| (StatusCode::BAD_REQUEST, why))?;
    let (path, house) = (path.to_owned(), Arc::clone(house));
    let made = tokio::task::spawn_blocking(move || packs::pack(&path, &asked, &house)).await;
    let pack = made.map_err(|e| crate::server::internal(&e))??;
    Ok(response(StatusCode::OK, "application/octet-stream", pack.to_bytes()))
}

/// A sentence.
pub(crate) fn plain(status: StatusCode, text: &str) -> Response<Body> {
    response(status, "text/plain; charset=utf-8", format!("{text}\n").into_bytes())
}

fn text_of(kind: &str, text: &str) -> Response<Body> {
    response(StatusCode::OK, &format!("{kind}; charset=utf-8"), text.as_bytes().to_vec())
}

fn response(status: StatusCode, kind: &str, bytes: Vec<u8>) -> Response<Body> {
    let mut response = Response::new(Full::new(Bytes::from(bytes)).boxed());
    *response.status_mut() = status;
    if let Ok(kind) = HeaderValue::from_str(kind) {
        response.headers_mut().insert(CONTENT_TYPE, kind);
    }
    response
}

/// What every answer says: nobody else may load, frame or keep it.
pub(crate) fn sealed(mut response: Response<Body>) -> Response<Body> {
    let all = [
        (CONTENT_SECURITY_POLICY, POLICY),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("x-content-type-options"), "nosniff"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ];
    for (name, value) in all {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}
