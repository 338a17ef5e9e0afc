//! Who may ask for what: names of the server, origins, the key, and what browsers are told about every answer.
//!
//! Entry point: [`Guard`]. Nothing is compared but whole strings: `127.0.0.1.evil` begins like a name of ours, and a page
//! that a name server has moved here sends the same `Host` and `Origin`.

use super::files::IMPORT_MAP;
use axum::http::header::{self, HeaderName, HeaderValue};
use axum::http::{HeaderMap, StatusCode};
use std::net::{IpAddr, SocketAddr};
use subtle::ConstantTimeEq as _;

/// Bytes of the key.
const KEY_BYTES: usize = 16;

/// Names and key of a server.
#[derive(Clone, Debug)]
pub struct Guard {
    /// Names with port that a request may be for.
    hosts: Vec<String>,
    key: String,
    /// Whether peers that are not on this machine may take control.
    control_from_anywhere: bool,
}

impl Guard {
    /// Of a server on this port, that others know by `names` besides.
    pub fn new(port: u16, names: &[String], key: String, control_from_anywhere: bool) -> Self {
        let own = ["127.0.0.1", "localhost", "[::1]"].map(str::to_owned);
        let hosts = own.iter().chain(names);
        Self {
            hosts: hosts
                .map(|name| format!("{}:{port}", name.to_ascii_lowercase()))
                .collect(),
            key,
            control_from_anywhere,
        }
    }

    /// Whether a request is for this server; the answer if not.
    ///
    /// # Errors
    /// 421: it is for another name, or for none.
    pub fn host(&self, headers: &HeaderMap) -> Result<(), StatusCode> {
        let mut all = headers.get_all(header::HOST).iter();
        let host = all.next().and_then(|host| host.to_str().ok());
        let is_ours = host.is_some_and(|host| {
            let host = host.to_ascii_lowercase();
            self.hosts.contains(&host)
        });
        if is_ours && all.next().is_none() {
            Ok(())
        } else {
            Err(StatusCode::MISDIRECTED_REQUEST)
        }
    }

    /// Whether a page or a program may open a socket; the answer if not.
    ///
    /// # Errors
    /// 403: another page's, or a program without the key in its `Authorization: Bearer`.
    pub fn origin(&self, headers: &HeaderMap) -> Result<(), StatusCode> {
        let mut all = headers.get_all(header::ORIGIN).iter();
        let is_ours = match all.next() {
            Some(origin) => origin.to_str().is_ok_and(|origin| {
                let ours = |host: &String| origin.strip_prefix("http://") == Some(host);
                self.hosts.iter().any(ours)
            }),
            None => {
                let given = headers.get(header::AUTHORIZATION);
                let given = given.and_then(|given| given.to_str().ok()?.strip_prefix("Bearer "));
                given.is_some_and(|given| self.is_key(given))
            }
        };
        if is_ours && all.next().is_none() {
            Ok(())
        } else {
            Err(StatusCode::FORBIDDEN)
        }
    }

    /// Whether this is the key; takes the same time for every wrong one of its length.
    pub fn is_key(&self, given: &str) -> bool {
        self.key.as_bytes().ct_eq(given.as_bytes()).into()
    }

    /// Whether a peer may take control at all.
    pub fn may_control(&self, peer: SocketAddr) -> bool {
        self.control_from_anywhere || is_local(peer.ip())
    }
}

fn is_local(address: IpAddr) -> bool {
    address.to_canonical().is_loopback()
}

/// A new key: 128 bits from the system, in hexadecimal.
///
/// # Errors
/// The system gives none.
pub fn new_key() -> Result<String, getrandom::Error> {
    let mut bytes = [0; KEY_BYTES];
    getrandom::fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// What comes with every answer.
pub fn headers() -> [(HeaderName, HeaderValue); 7] {
    let policy = format!(
        "default-src 'none'; script-src 'self'{IMPORT_MAP}; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; \
         media-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    let policy = HeaderValue::from_str(&policy);
    let fixed = HeaderValue::from_static;
    [
        (
            header::CONTENT_SECURITY_POLICY,
            policy.unwrap_or_else(|_| fixed("default-src 'none'")),
        ),
        (header::X_CONTENT_TYPE_OPTIONS, fixed("nosniff")),
        (header::REFERRER_POLICY, fixed("no-referrer")),
        (header::CACHE_CONTROL, fixed("no-store")),
        (header::X_FRAME_OPTIONS, fixed("DENY")),
        (
            HeaderName::from_static("cross-origin-opener-policy"),
            fixed("same-origin"),
        ),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            fixed("same-origin"),
        ),
    ]
}
