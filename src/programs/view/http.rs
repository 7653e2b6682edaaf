//! The little HTTP that a local page needs: one request head in, one response out.
//!
//! Only `GET` is understood, only paths that start with `/` and contain plain characters; a request
//! with a body, without exactly one `Host` or with a `Host` that is not this machine's is refused.
//! The last point keeps a foreign web page, whose name has been pointed at 127.0.0.1 (DNS
//! rebinding), from reading the scene.

use flate2::read::GzDecoder;
use std::io::{Read, Write};
use std::sync::Arc;

/// Longest request head in bytes: far above what a browser sends to a page without cookies.
pub const MAX_HEAD: usize = 16 * 1024;

/// Longest request target in bytes: colours of all classes of a scene are named in one.
const MAX_TARGET: usize = 8192;

/// A request that may be answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The path, without the query.
    pub path: String,
    /// What follows the question mark, or nothing.
    pub query: String,
    /// Whether the client understands gzip.
    pub accepts_gzip: bool,
    /// Whether the client wants the connection kept.
    pub keep_alive: bool,
}

impl Request {
    /// A value of the query.
    #[must_use]
    pub fn text(&self, key: &str) -> Option<&str> {
        self.query
            .split('&')
            .find_map(|pair| pair.strip_prefix(key)?.strip_prefix('='))
    }

    /// A finite number of the query.
    #[must_use]
    pub fn number(&self, key: &str) -> Option<f32> {
        self.text(key)?.parse().ok().filter(|x: &f32| x.is_finite())
    }
}

/// The content of a response.
#[derive(Clone, Debug)]
pub enum Body {
    /// As it is.
    Plain(Vec<u8>),
    /// Part of the program.
    Embedded(&'static [u8]),
    /// Compressed already, shared with other requests.
    Gzip(Arc<Vec<u8>>),
}

/// An answer.
#[derive(Clone, Debug)]
pub struct Response {
    /// Status code.
    pub status: u16,
    /// Media type of the content.
    pub media_type: &'static str,
    /// The content.
    pub body: Body,
}

impl Response {
    /// Text for people, used for refusals.
    #[must_use]
    pub fn text(status: u16, message: &str) -> Self {
        Self {
            status,
            media_type: "text/plain; charset=utf-8",
            body: Body::Plain(format!("{message}\n").into_bytes()),
        }
    }

    /// A JSON value.
    #[must_use]
    pub fn json(value: &serde_json::Value) -> Self {
        Self {
            status: 200,
            media_type: "application/json",
            body: Body::Plain(value.to_string().into_bytes()),
        }
    }

    /// Writes the response; content is unpacked for a client that does not understand gzip.
    pub fn write(
        &self,
        out: &mut impl Write,
        accepts_gzip: bool,
        keep_alive: bool,
    ) -> std::io::Result<()> {
        let unpacked;
        let (bytes, packed): (&[u8], bool) = match &self.body {
            Body::Plain(bytes) => (bytes, false),
            Body::Embedded(bytes) => (bytes, false),
            Body::Gzip(bytes) if accepts_gzip => (bytes, true),
            Body::Gzip(bytes) => {
                let mut plain = Vec::new();
                GzDecoder::new(&bytes[..]).read_to_end(&mut plain)?;
                unpacked = plain;
                (&unpacked, false)
            }
        };
        let head = format!(
            "HTTP/1.1 {} {}\r\nContent-Type: {}\r\nContent-Length: {}\r\n{}{}Connection: {}\r\n{HARDENING}\r\n",
            self.status,
            reason(self.status),
            self.media_type,
            bytes.len(),
            if packed {
                "Content-Encoding: gzip\r\n"
            } else {
                ""
            },
            if self.status == 405 {
                "Allow: GET\r\n"
            } else {
                ""
            },
            if keep_alive { "keep-alive" } else { "close" },
        );
        out.write_all(head.as_bytes())?;
        out.write_all(bytes)?;
        out.flush()
    }
}

/// Headers of every response: nothing but our own files runs, nobody else may embed or read them,
/// nothing is kept.
const HARDENING: &str = "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
    X-Frame-Options: DENY\r\nCross-Origin-Resource-Policy: same-origin\r\nCross-Origin-Opener-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n";

fn reason(status: u16) -> &'static str {
    match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        408 => "Request Timeout",
        431 => "Request Header Fields Too Large",
        503 => "Service Unavailable",
        505 => "HTTP Version Not Supported",
        _ => "Internal Server Error",
    }
}

/// Understands a request head (without the empty line at its end), or says how to refuse it.
///
/// `hosts` are the values of `Host` under which this server may be addressed, in lower case.
///
/// # Errors
/// The answer that refuses the request.
pub fn parse(head: &[u8], hosts: &[String]) -> Result<Request, Response> {
    let refuse = |status, message: &str| Err(Response::text(status, message));
    let Ok(head) = std::str::from_utf8(head) else {
        return refuse(400, "the request is not text");
    };
    let mut lines = head.split("\r\n");
    let mut first = lines.next().unwrap_or_default().split(' ');
    let (Some(method), Some(target), Some(version), None) =
        (first.next(), first.next(), first.next(), first.next())
    else {
        return refuse(400, "expected: GET /path HTTP/1.1");
    };
    if !matches!(version, "HTTP/1.1" | "HTTP/1.0") {
        return refuse(505, "expected HTTP/1.1");
    }
    if method != "GET" {
        return refuse(405, "this page can only be read");
    }
    let mut hosts_given = Vec::new();
    let (mut accepts_gzip, mut keep_alive) = (false, version == "HTTP/1.1");
    for line in lines {
        let Some((name, value)) = line.split_once(':') else {
            return refuse(400, "a header line has no colon");
        };
        if name.is_empty()
            || !name
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
        {
            return refuse(400, "a header name is malformed");
        }
        let value = value.trim();
        match name.to_ascii_lowercase().as_str() {
            "host" => hosts_given.push(value.to_ascii_lowercase()),
            "accept-encoding" => {
                accepts_gzip = value.split(',').any(|e| matches!(e.trim(), "gzip" | "*"))
            }
            "connection" if value.eq_ignore_ascii_case("close") => keep_alive = false,
            "content-length" if value == "0" => {}
            "content-length" | "transfer-encoding" => {
                return refuse(400, "a request with a body is not understood");
            }
            _ => {}
        }
    }
    match &hosts_given[..] {
        [host] if hosts.contains(host) => {}
        [_] => {
            return refuse(
                403,
                "this page belongs to this machine alone: open the address that `unbake view` printed",
            );
        }
        _ => return refuse(400, "exactly one Host is expected"),
    }
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"/._-?=&+".contains(&b);
    if target.len() > MAX_TARGET
        || !target.starts_with('/')
        || !target.bytes().all(plain)
        || target.contains("..")
    {
        return refuse(404, "no such page");
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    Ok(Request {
        path: path.into(),
        query: query.into(),
        accepts_gzip,
        keep_alive,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hosts() -> Vec<String> {
        vec!["127.0.0.1:8321".into(), "localhost:8321".into()]
    }

    fn status(head: &str) -> u16 {
        parse(head.as_bytes(), &hosts()).map_or_else(|r| r.status, |_| 200)
    }

    #[test]
    fn a_browsers_request_is_understood() {
        let head = "GET /api/inspect.json?u=0.25&v=1e-3 HTTP/1.1\r\nHost: LOCALHOST:8321\r\nAccept-Encoding: gzip, br";
        let request = parse(head.as_bytes(), &hosts()).expect("fine");
        assert_eq!(request.path, "/api/inspect.json");
        assert!(request.accepts_gzip && request.keep_alive);
        assert_eq!(
            (
                request.number("u"),
                request.number("v"),
                request.number("w")
            ),
            (Some(0.25), Some(1e-3), None)
        );
    }

    #[test]
    fn hostile_requests_are_refused() {
        let host = "\r\nHost: localhost:8321";
        for (head, expected) in [
            (format!("POST / HTTP/1.1{host}"), 405),
            (format!("DELETE / HTTP/1.1{host}"), 405),
            (format!("get / HTTP/1.1{host}"), 405),
            ("GET / HTTP/1.1".into(), 400),
            ("GET / HTTP/1.1\r\nHost: evil.example".into(), 403),
            ("GET / HTTP/1.1\r\nHost: evil.example:8321".into(), 403),
            (
                "GET / HTTP/1.1\r\nHost: 127.0.0.1:8321.evil.example".into(),
                403,
            ),
            ("GET / HTTP/1.1\r\nHost: localhost:8322".into(), 403),
            ("GET / HTTP/1.1\r\nHost: localhost".into(), 403),
            (format!("GET / HTTP/1.1{host}{host}"), 400),
            (format!("GET /../etc/passwd HTTP/1.1{host}"), 404),
            (format!("GET /%2e%2e/etc/passwd HTTP/1.1{host}"), 404),
            (format!("GET /a\\b HTTP/1.1{host}"), 404),
            (format!("GET http://localhost:8321/ HTTP/1.1{host}"), 404),
            (format!("GET * HTTP/1.1{host}"), 404),
            (
                format!("GET /{} HTTP/1.1{host}", "a".repeat(MAX_TARGET)),
                404,
            ),
            (format!("GET / HTTP/2.0{host}"), 505),
            (format!("GET /  HTTP/1.1{host}"), 400),
            (format!("GET / HTTP/1.1{host}\r\nContent-Length: 5"), 400),
            (
                format!("GET / HTTP/1.1{host}\r\nTransfer-Encoding: chunked"),
                400,
            ),
            (format!("GET / HTTP/1.1{host}\r\nno colon"), 400),
            (format!("GET / HTTP/1.1{host}\r\n folded: x"), 400),
            (String::new(), 400),
        ] {
            assert_eq!(status(&head), expected, "{head:?}");
        }
        assert_eq!(
            parse(b"GET /\xff HTTP/1.1", &hosts())
                .expect_err("not text")
                .status,
            400
        );
    }

    #[test]
    fn numbers_of_a_query_are_finite_or_absent() {
        let request = |query: &str| Request {
            path: "/".into(),
            query: query.into(),
            accepts_gzip: false,
            keep_alive: false,
        };
        for bad in ["u=NaN", "u=inf", "u=", "u=x", "uu=1", "1"] {
            assert_eq!(request(bad).number("u"), None, "{bad}");
        }
        assert_eq!(request("v=2&u=-1.5").number("u"), Some(-1.5));
    }

    #[test]
    fn content_is_unpacked_for_a_client_without_gzip() {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(b"hello hello hello").expect("packs");
        let body = Body::Gzip(Arc::new(encoder.finish().expect("packs")));
        let response = Response {
            status: 200,
            media_type: "text/plain",
            body,
        };
        let mut plain = Vec::new();
        response.write(&mut plain, false, false).expect("writes");
        assert!(plain.ends_with(b"\r\n\r\nhello hello hello"));
        let mut packed = Vec::new();
        response.write(&mut packed, true, true).expect("writes");
        assert!(String::from_utf8_lossy(&packed).contains("Content-Encoding: gzip"));
    }
}
