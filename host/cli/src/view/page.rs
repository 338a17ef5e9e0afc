//! The page of a command: its server, and the line that says where it is; or what is shown inside the program alone.
//!
//! Entry points: [`Page::open`], [`Page::inside`].

use super::args::{Control, PageArgs};
use crate::failure::{Cause, Failure};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use sutura_view::{Options, Redirect, Request, Server, Shared};

/// What is shown, who serves it if anybody does, and what clients ask for.
pub struct Page {
    shared: Arc<Shared>,
    server: Option<Server>,
    asked: Option<Receiver<Request>>,
    /// File that a browser was told to open; it may read it late.
    _redirect: Option<Redirect>,
}

impl Page {
    /// Starts to serve, and says where.
    ///
    /// # Errors
    /// No port, or options that do not go together.
    pub fn open(args: &PageArgs) -> Result<Page, Failure> {
        let options = Options {
            port: args.view_port,
            bind: args.view_bind,
            names: args.view_host.clone(),
            control_from_anywhere: args.view_control == Control::Any,
        };
        let (server, asked) = Server::start(&options)
            .map_err(|error| Failure::say(Cause::BadInput, error.to_string(), error.help()))?;
        let url = server.url();
        note!("see it: {url}");
        let port = server.address().port();
        if std::env::var_os("SSH_CONNECTION").is_some() && args.view_bind.is_loopback() {
            note!(
                "from your own machine: ssh -L {port}:127.0.0.1:{port} THIS-MACHINE, then open that address there"
            );
        }
        if !args.view_bind.is_loopback() {
            note!(
                "the page is reached from other machines, and what goes to and from it is not encrypted"
            );
        }
        let redirect = args.open.then(|| browse(&url)).flatten();
        Ok(Page {
            _redirect: redirect,
            shared: server.shared().clone(),
            server: Some(server),
            asked: Some(asked),
        })
    }

    /// Shows to parts of this program alone: no port is opened.
    pub fn inside() -> Page {
        let (requests, asked) = channel();
        Page {
            shared: Shared::new(requests),
            server: None,
            asked: Some(asked),
            _redirect: None,
        }
    }

    /// What it shows.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// What clients ask for; whoever takes it answers.
    pub fn take_asked(&mut self) -> Option<Receiver<Request>> {
        self.asked.take()
    }

    /// Where it is, without the key; none if nobody serves it.
    pub fn place(&self) -> Option<String> {
        let url = self.url()?;
        Some(url.split('#').next().unwrap_or_default().to_owned())
    }

    /// Where it is, with the key; none if nobody serves it.
    pub fn url(&self) -> Option<String> {
        self.server.as_ref().map(Server::url)
    }
}

/// Opens an address in the user's browser, if there is one. It has a key, so that a file leads there, and not a command line.
fn browse(url: &str) -> Option<Redirect> {
    let redirect = match Redirect::to(url) {
        Ok(redirect) => redirect,
        Err(error) => {
            note!("no browser was opened, there is no file to lead it to the page: {error}");
            return None;
        }
    };
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else {
        "xdg-open"
    };
    let opened = Command::new(program)
        .arg(redirect.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    if let Err(error) = opened {
        note!("no browser was opened, `{program}` does not run: {error}");
    }
    Some(redirect)
}
