//! Which session is looked at: by its address, or the one of this user that answers.
//!
//! Entry point: [`find`].

use crate::failure::{Cause, Failure};
use std::io::{self, IsTerminal as _};
use std::net::TcpStream;
use std::time::Duration;
use sutura_view::{Noted, noted};

/// How long a server of this machine may take to answer.
const ANSWERS_WITHIN: Duration = Duration::from_secs(1);

/// Where a session is shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Server {
    /// Name and port.
    pub address: String,
    /// Its key.
    pub key: String,
    /// Its process, if it runs here.
    pid: Option<u32>,
}

/// The session at an address, or the one that there is.
///
/// # Errors
/// No such session; several of them, and nobody to ask.
pub fn find(url: Option<&str>) -> Result<Server, Failure> {
    let here = || {
        let all = noted().into_iter();
        all.map(Server::from).collect::<Vec<_>>()
    };
    match url {
        Some(url) => named(url, &here()),
        None => only(here().into_iter().filter(Server::answers).collect()),
    }
}

impl From<Noted> for Server {
    fn from(noted: Noted) -> Self {
        Self {
            address: noted.address.to_string(),
            key: noted.key,
            pid: Some(noted.pid),
        }
    }
}

impl Server {
    /// Whether its program still runs.
    fn answers(&self) -> bool {
        let address = self.address.parse().ok();
        address.is_some_and(|address| TcpStream::connect_timeout(&address, ANSWERS_WITHIN).is_ok())
    }
}

fn bad(message: String, help: &str) -> Failure {
    Failure::say(Cause::BadInput, message, help)
}

/// An address as it is printed; its key may be left out if the session is one of `here`.
fn named(url: &str, here: &[Server]) -> Result<Server, Failure> {
    let (place, key) = url.split_once('#').unwrap_or((url, ""));
    let place = place.strip_prefix("http://").unwrap_or(place);
    let address = place.trim_end_matches('/');
    let is_address = address
        .rsplit_once(':')
        .is_some_and(|(name, port)| !name.is_empty() && port.parse::<u16>().is_ok());
    if !is_address || address.contains('/') {
        let message = format!("`{url}` is not the address of a session's page");
        return Err(bad(
            message,
            "give it as it was printed: http://127.0.0.1:8421/#key=...",
        ));
    }
    let given = key.split('&').find_map(|part| part.strip_prefix("key="));
    let local = address.replacen("localhost:", "127.0.0.1:", 1);
    let known = here.iter().find(|server| server.address == local);
    match (given, known) {
        (Some(key), _) => Ok(Server {
            address: address.to_owned(),
            key: key.to_owned(),
            pid: None,
        }),
        (None, Some(known)) => Ok(known.clone()),
        (None, None) => Err(bad(
            format!("the key of the session at {address} is not known here"),
            "give the whole address as it was printed, in quotes: 'http://127.0.0.1:8421/#key=...'",
        )),
    }
}

/// The one that there is; of several, the one that is chosen.
fn only(mut all: Vec<Server>) -> Result<Server, Failure> {
    if all.len() > 1 && io::stdin().is_terminal() && io::stderr().is_terminal() {
        return choose(&all);
    }
    match (all.pop(), all.len()) {
        (Some(one), 0) => Ok(one),
        (None, _) => Err(bad(
            "no session of this user with a page runs on this machine".to_owned(),
            "begin one with `sutura view` or `sutura run --view`, or give the address that another has printed",
        )),
        (Some(last), _) => {
            all.push(last);
            let each = all.iter().map(|server| server.address.clone());
            let message = format!(
                "{} sessions run here: {}",
                all.len(),
                each.collect::<Vec<_>>().join(", ")
            );
            let help = format!("choose one: sutura top http://{}", all[0].address);
            Err(bad(message, &help))
        }
    }
}

fn choose(all: &[Server]) -> Result<Server, Failure> {
    for (number, server) in (1..).zip(all) {
        let pid = server
            .pid
            .map_or(String::new(), |pid| format!(" (process {pid})"));
        note!("{number}  http://{}{pid}", server.address);
    }
    note!("which one? 1 to {}", all.len());
    let mut line = String::new();
    let read = io::stdin().read_line(&mut line);
    let number = line.trim().parse::<usize>().ok().filter(|_| read.is_ok());
    let chosen = number.and_then(|number| all.get(number.checked_sub(1)?));
    chosen.cloned().ok_or_else(|| {
        let message = format!("`{}` is none of these sessions", line.trim());
        bad(
            message,
            "give a number of the list, or the session's address",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn here(port: u16) -> Server {
        Server {
            address: format!("127.0.0.1:{port}"),
            key: format!("key{port}"),
            pid: Some(7),
        }
    }

    #[test]
    fn addresses_are_as_printed_or_shorter_where_the_session_is_known() {
        let all = [here(8421), here(8422)];
        let key = |url: &str| named(url, &all).map(|server| (server.address, server.key));
        let whole = key("http://lab-pc:9000/#key=abc&view=1").expect("an address");
        assert_eq!(whole, ("lab-pc:9000".to_owned(), "abc".to_owned()));
        for short in [
            "http://localhost:8422",
            "127.0.0.1:8422",
            "http://127.0.0.1:8422/",
        ] {
            assert_eq!(key(short).expect(short).1, "key8422");
        }
        for wrong in [
            "127.0.0.1:8423",
            "8421",
            "http://127.0.0.1/",
            "http://a:1/x",
            ":1",
            "",
        ] {
            assert!(named(wrong, &all).is_err(), "{wrong}");
        }
    }

    /// Tests have no terminal to ask at.
    #[test]
    fn one_session_is_taken_and_several_are_listed() {
        assert_eq!(only(vec![here(1)]).expect("one"), here(1));
        assert!(only(Vec::new()).is_err());
        if !io::stdin().is_terminal() {
            let several = only(vec![here(1), here(2)]).expect_err("two");
            assert!(
                several
                    .report
                    .to_string()
                    .contains("127.0.0.1:1, 127.0.0.1:2")
            );
        }
    }
}
