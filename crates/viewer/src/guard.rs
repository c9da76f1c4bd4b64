//! Access control: requests need the token and must come from the page itself.
//!
//! The server listens on the loopback interface only, but other pages in the browser can also send requests to it: by
//! a name that resolves to 127.0.0.1 (DNS rebinding), or by a form or script of another origin. Therefore `Host` and,
//! if present, `Origin` must be those of the server, and the path must begin with the token. Only the printed address
//! has the token.

use hyper::header::{CONTENT_LENGTH, HOST, HeaderMap, HeaderName, ORIGIN, TRANSFER_ENCODING};
use hyper::{Method, StatusCode, Uri};

/// Maximum length of path and query, bytes.
const MAX_QUERY_BYTES: usize = 2_000;

/// Access control of a page.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    token: String,
    hosts: [String; 2],
    /// Whether pages of other origins on this machine, such as a notebook, may show the page in a frame.
    is_framed: bool,
}

impl Guard {
    /// Creates the access control of a page on `port`, with a random token.
    pub(crate) fn new(port: u16, is_framed: bool) -> Result<Self, getrandom::Error> {
        let mut bytes = [0u8; 16];
        getrandom::fill(&mut bytes)?;
        let token = format!("{:032x}", u128::from_be_bytes(bytes));
        Ok(Self { token, hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")], is_framed })
    }

    /// Returns the address of the page, with the token.
    pub(crate) fn address(&self) -> String {
        format!("http://{}/{}/", self.hosts[0], self.token)
    }

    /// Returns whether other pages may show the page in a frame.
    pub(crate) fn is_framed(&self) -> bool {
        self.is_framed
    }

    /// Checks a request and returns the part of its path after the token.
    ///
    /// # Errors
    /// The request has another host, origin or method, a body, too long a path, or no valid token: the status of the
    /// answer.
    pub(crate) fn admit<'a>(&self, method: &Method, uri: &'a Uri, headers: &HeaderMap) -> Result<&'a str, StatusCode> {
        let is_server = |text: &str| self.hosts.iter().any(|host| host == text);
        if !single_value(headers, &HOST).is_some_and(is_server) {
            return Err(StatusCode::MISDIRECTED_REQUEST);
        }
        let is_server_origin = |text: &str| text.strip_prefix("http://").is_some_and(is_server);
        if headers.contains_key(ORIGIN) && !single_value(headers, &ORIGIN).is_some_and(is_server_origin) {
            return Err(StatusCode::FORBIDDEN);
        }
        let fetch = |name| headers.contains_key(name).then(|| single_value(headers, &HeaderName::from_static(name)));
        let is_same_origin = fetch("sec-fetch-site").is_none_or(|site| matches!(site, Some("same-origin" | "none")));
        let is_frame = self.is_framed && fetch("sec-fetch-dest") == Some(Some("iframe"));
        if !is_same_origin && !is_frame {
            return Err(StatusCode::FORBIDDEN);
        }
        if method != Method::GET {
            return Err(StatusCode::METHOD_NOT_ALLOWED);
        }
        if headers.contains_key(TRANSFER_ENCODING) || single_value(headers, &CONTENT_LENGTH).is_some_and(|v| v != "0") {
            return Err(StatusCode::PAYLOAD_TOO_LARGE);
        }
        if uri.path_and_query().is_none_or(|all| all.as_str().len() > MAX_QUERY_BYTES) {
            return Err(StatusCode::URI_TOO_LONG);
        }
        let (token, path) = uri.path().trim_start_matches('/').split_once('/').ok_or(StatusCode::NOT_FOUND)?;
        if is_same_token(token.as_bytes(), self.token.as_bytes()) { Ok(path) } else { Err(StatusCode::NOT_FOUND) }
    }
}

/// Returns the value of a header; `None` unless it occurs exactly once, as visible ASCII.
fn single_value<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let first = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(first)
}

/// Returns whether two tokens are equal, in constant time, so that response times do not reveal the valid one.
fn is_same_token(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |difference, (a, b)| difference | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the admitted path, or the status of the refusal.
    fn status_of(guard: &Guard, path: &str, headers: &[(&'static str, &str)]) -> Result<String, u16> {
        let mut all = HeaderMap::new();
        for (name, value) in headers {
            all.append(*name, value.parse().unwrap());
        }
        let uri: Uri = path.parse().unwrap();
        guard.admit(&Method::GET, &uri, &all).map(str::to_owned).map_err(|status| status.as_u16())
    }

    #[test]
    fn admits_requests_with_token_from_own_origin() {
        let guard = Guard::new(4711, false).unwrap();
        let path = format!("/{}/predict?tx=1,2,3", guard.token);
        let host = ("host", "127.0.0.1:4711");
        assert_eq!(status_of(&guard, &path, &[host]).unwrap(), "predict");
        assert_eq!(
            status_of(&guard, &path, &[("host", "localhost:4711"), ("origin", "http://localhost:4711")]).unwrap(),
            "predict"
        );
        assert_eq!(status_of(&guard, &path, &[host, ("sec-fetch-site", "same-origin")]).unwrap(), "predict");
        assert_ne!(Guard::new(4711, false).unwrap().token, guard.token, "tokens differ");
        assert_eq!(guard.token.len(), 32);
    }

    #[test]
    fn admits_frames_of_other_origins_only_in_notebooks() {
        let headers = |dest| [("host", "localhost:4711"), ("sec-fetch-site", "same-site"), ("sec-fetch-dest", dest)];
        for (is_framed, dest, expected) in
            [(true, "iframe", Ok(String::new())), (true, "script", Err(403)), (false, "iframe", Err(403))]
        {
            let guard = Guard::new(4711, is_framed).unwrap();
            assert_eq!(
                status_of(&guard, &format!("/{}/", guard.token), &headers(dest)),
                expected,
                "{is_framed} {dest}"
            );
        }
    }

    /// Path, headers, and expected status.
    type Case<'a> = (&'a str, &'a [(&'static str, &'a str)], u16);

    #[test]
    fn rejects_requests_without_token_or_from_other_origins() {
        let guard = Guard::new(4711, false).unwrap();
        let path = format!("/{}/predict", guard.token);
        let host = ("host", "127.0.0.1:4711");
        let cases: &[Case<'_>] = &[
            (&path, &[], 421),
            (&path, &[("host", "evil.example:4711")], 421),
            (&path, &[("host", "127.0.0.1:80")], 421),
            (&path, &[host, ("host", "127.0.0.1:4711")], 421),
            (&path, &[host, ("origin", "http://evil.example")], 403),
            (&path, &[host, ("origin", "null")], 403),
            (&path, &[host, ("origin", "https://127.0.0.1:4711")], 403),
            (&path, &[host, ("sec-fetch-site", "cross-site")], 403),
            (&path, &[host, ("content-length", "5")], 413),
            (&path, &[host, ("transfer-encoding", "chunked")], 413),
            ("/", &[host], 404),
            ("/predict", &[host], 404),
            ("/00000000000000000000000000000000/predict", &[host], 404),
            (&format!("/{}", guard.token), &[host], 404),
            (&format!("/{}0/predict", guard.token), &[host], 404),
            (&format!("{path}?{}", "x".repeat(3_000)), &[host], 414),
        ];
        for (path, headers, status) in cases {
            assert_eq!(status_of(&guard, path, headers), Err(*status), "{path} {headers:?}");
        }
        let uri: Uri = path.parse().unwrap();
        let mut headers = HeaderMap::new();
        headers.append("host", "127.0.0.1:4711".parse().unwrap());
        assert_eq!(guard.admit(&Method::POST, &uri, &headers), Err(StatusCode::METHOD_NOT_ALLOWED));
    }
}
