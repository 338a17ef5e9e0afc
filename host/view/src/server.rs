//! The server: one thread, one port.
//!
//! Entry point: [`Server::start`].

use super::client::{MOST_BYTES, MOST_BYTES_OF_A_FRAME, serve};
use super::files::find;
use super::guard::{Guard, headers, new_key};
use super::notes::note;
use super::shared::{Request, Shared};
use super::waiting::{Guest, HEADER_WITHIN, Waiting};
use axum::Extension;
use axum::Router;
use axum::extract::{Request as HttpRequest, State, WebSocketUpgrade};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse as _, Response};
use axum::routing::any;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::oneshot;

/// The port that is tried first.
pub const PORT: u16 = 8421;
/// How many ports are tried.
const TRIES: u16 = 10;
/// Pause where the system has no more connections to give.
const PAUSE: Duration = Duration::from_millis(100);
/// How long clients may take to hear that it is over.
const ENDS_WITHIN: Duration = Duration::from_millis(500);

/// How a server is reached.
#[derive(Clone, Debug)]
pub struct Options {
    /// The first port that is tried; 0: any.
    pub port: u16,
    /// Where it listens.
    pub bind: IpAddr,
    /// Names, without port, that others know it by.
    pub names: Vec<String>,
    /// Whether peers on other machines may take control.
    pub control_from_anywhere: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            port: PORT,
            bind: Ipv4Addr::LOCALHOST.into(),
            names: Vec::new(),
            control_from_anywhere: false,
        }
    }
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// No port is free.
    #[error("no port from {port} on {bind} to {last} is free for the page: {source}", last = port.saturating_add(TRIES - 1))]
    Port {
        /// The first that was tried.
        port: u16,
        /// Where.
        bind: IpAddr,
        /// What the system says of the last one.
        source: io::Error,
    },
    /// Listening beyond this machine without saying by which name.
    #[error(
        "the page is to listen on {bind}, which other machines reach, and no name is given by which they do"
    )]
    NoName {
        /// Where.
        bind: IpAddr,
    },
    /// The system gives no random key.
    #[error("the system gives no random key: {0}")]
    Key(String),
    /// There is no thread to serve from.
    #[error("the page's server does not start: {0}")]
    Thread(io::Error),
}

impl ViewError {
    /// What to do about it.
    pub fn help(&self) -> &'static str {
        match self {
            Self::Port { .. } => "give another one with --view-port, or end what uses them",
            Self::NoName { .. } => "add --view-host NAME, as others write it in the address",
            Self::Key(_) | Self::Thread(_) => "see what this machine lacks with `sutura doctor`",
        }
    }
}

/// A running server. Dropped, it ends.
#[derive(Debug)]
pub struct Server {
    shared: Arc<Shared>,
    address: SocketAddr,
    key: String,
    names: Vec<String>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
    note: Option<PathBuf>,
}

#[derive(Clone)]
struct Served {
    guard: Arc<Guard>,
    shared: Arc<Shared>,
}

impl Server {
    /// Starts to serve; what clients ask for comes from the receiver.
    ///
    /// # Errors
    /// See [`ViewError`].
    pub fn start(options: &Options) -> Result<(Self, Receiver<Request>), ViewError> {
        if !options.bind.is_loopback() && options.names.is_empty() {
            return Err(ViewError::NoName { bind: options.bind });
        }
        let listener = listen(options)?;
        let address = listener.local_addr().map_err(ViewError::Thread)?;
        let key = new_key().map_err(|error| ViewError::Key(error.to_string()))?;
        let (requests, asked) = channel();
        let shared = Shared::new(requests);
        let guard = Guard::new(
            address.port(),
            &options.names,
            key.clone(),
            options.control_from_anywhere,
        );
        let served = Served {
            guard: Arc::new(guard),
            shared: shared.clone(),
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(ViewError::Thread)?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new().name("sutura-view".to_owned());
        let thread = thread.spawn(move || {
            let served = runtime.block_on(async {
                let listener = tokio::net::TcpListener::from_std(listener)?;
                tokio::select! {
                    () = accept(listener, router(served)) => {}
                    _ = stopped => {}
                }
                io::Result::Ok(())
            });
            if let Err(error) = served {
                tracing::error!("the page is no longer served: {error}");
            }
            runtime.shutdown_timeout(ENDS_WITHIN);
        });
        let server = Self {
            shared,
            address,
            note: note(address, &key),
            key,
            names: options.names.clone(),
            stop: Some(stop),
            thread: Some(thread.map_err(ViewError::Thread)?),
        };
        Ok((server, asked))
    }

    /// What it shows.
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The key that clients must have.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// The address of the page, with its key.
    pub fn url(&self) -> String {
        let name = self.names.first().map_or("127.0.0.1", String::as_str);
        format!("http://{name}:{}/#key={}", self.address.port(), self.key)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(note) = self.note.take() {
            let _ = std::fs::remove_file(note);
        }
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // It ends by itself; a panic of it has been printed.
            let _ = thread.join();
        }
    }
}

/// The first port that is free.
fn listen(options: &Options) -> Result<TcpListener, ViewError> {
    let last = options.port.saturating_add(TRIES - 1);
    let ports = if options.port == 0 {
        0..=0
    } else {
        options.port..=last
    };
    let mut error = io::Error::from(io::ErrorKind::AddrInUse);
    for port in ports {
        let bound = TcpListener::bind((options.bind, port));
        match bound.and_then(|listener| listener.set_nonblocking(true).map(|()| listener)) {
            Ok(listener) => return Ok(listener),
            Err(why) => error = why,
        }
    }
    Err(ViewError::Port {
        port: options.port,
        bind: options.bind,
        source: error,
    })
}

/// Peer of a connection.
#[derive(Clone)]
struct Peer {
    address: SocketAddr,
    guest: Arc<Guest>,
}

/// Takes connections for ever.
async fn accept(listener: tokio::net::TcpListener, router: Router) {
    let waiting = Arc::new(Waiting::default());
    loop {
        let (stream, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::debug!("a connection was not taken: {error}");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        // An answer does not wait until the client has said that it has what came before.
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!("answers may wait for each other: {error}");
        }
        let guest = Arc::new(waiting.enter());
        let peer = Peer { address, guest };
        tokio::spawn(converse(stream, router.clone(), peer));
    }
}

/// Answers a connection's requests until it ends, is idle for too long, or has to go for another one. A socket goes on by itself.
async fn converse(stream: tokio::net::TcpStream, router: Router, peer: Peer) {
    let guest = peer.guest.clone();
    let service = TowerToHyperService::new(router.layer(Extension(peer)));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_WITHIN)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    tokio::select! {
        ended = connection => if let Err(error) = ended {
            tracing::debug!("a connection ended: {error}");
        },
        () = guest.dismissed() => {}
        () = guest.idle() => {}
    }
}

fn router(served: Served) -> Router {
    Router::new()
        .route("/ws", any(socket))
        .fallback(file)
        .layer(from_fn_with_state(served.clone(), guarded))
        .with_state(served)
}

/// Refuses what is for another name, and says to browsers what all answers say.
async fn guarded(
    State(served): State<Served>,
    Extension(Peer { guest, .. }): Extension<Peer>,
    request: HttpRequest,
    next: Next,
) -> Response {
    guest.asks();
    let mut response = match served.guard.host(request.headers()) {
        Ok(()) => next.run(request).await,
        Err(code) => code.into_response(),
    };
    response.headers_mut().extend(headers());
    guest.is_answered();
    response
}

async fn file(request: HttpRequest) -> Response {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return StatusCode::METHOD_NOT_ALLOWED.into_response();
    }
    match find(request.uri().path()) {
        Some(file) => ([(header::CONTENT_TYPE, file.kind)], file.bytes).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

async fn socket(
    State(served): State<Served>,
    Extension(peer): Extension<Peer>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    if let Err(code) = served.guard.origin(&headers) {
        return code.into_response();
    }
    match upgrade {
        Ok(upgrade) => upgrade
            .max_message_size(MOST_BYTES)
            // Read to its end, so that no unread rest resets the connection before the client has read why it ends.
            .max_frame_size(MOST_BYTES_OF_A_FRAME)
            .on_upgrade(move |socket| {
                serve(
                    socket,
                    peer.address,
                    peer.guest,
                    served.shared,
                    served.guard,
                )
            }),
        Err(rejection) => rejection.into_response(),
    }
}
