//! A small HTTP server for the page of runs that may still be running.
//!
//! It listens on 127.0.0.1 only, and answers only browsers that ask for this machine by name. It is
//! read-only: its answers are the page, and the data that the page asks for by number. No request
//! names a file. Each connection has a thread and a time limit, so a slow client delays nobody.

mod request;
mod response;

use super::page::{LivePage, LiveState};
use request::Request;
use response::{Content, Response, Status};
use serde_json::json;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread;
use std::time::{Duration, Instant};

/// Maximum number of connections at a time. A browser opens six.
const MAX_CONNECTIONS: usize = 64;
/// Minimum time between two looks at the folders of the runs.
const REFRESH: Duration = Duration::from_millis(500);
/// Between two looks at the folders passes at least this multiple of the time that the last one
/// took, so that a page of many simulations takes no cores from those that run.
const REST: u32 = 20;
/// Time after a failed accept, for example without free file descriptors.
const PAUSE: Duration = Duration::from_millis(50);

/// Why the server cannot start.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot listen on {address}: {cause}; choose another port with --port, or 0 for any free one"
)]
pub struct ServeError {
    /// The address.
    pub address: SocketAddr,
    /// The cause.
    pub cause: io::Error,
}

/// The server of a page.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    shared: Arc<Shared>,
}

/// Stops a server.
#[derive(Debug, Clone)]
pub struct Stopper {
    address: SocketAddr,
    shared: Arc<Shared>,
}

/// What the threads of the connections share.
#[derive(Debug)]
struct Shared {
    html: Vec<u8>,
    page: Mutex<Followed>,
    state: Mutex<Seen>,
    connections: AtomicUsize,
    stopped: AtomicBool,
}

/// The page, with the time of the next look at its folders.
#[derive(Debug)]
struct Followed {
    page: LivePage,
    next: Instant,
}

/// The result of the last look.
#[derive(Debug, Clone)]
struct Seen {
    state: Arc<LiveState>,
    /// Whether a process works on them.
    running: bool,
    /// Why the runs cannot be read any more.
    problem: Option<String>,
}

impl Server {
    /// Listens on a port of 127.0.0.1; 0 is any free one.
    ///
    /// # Errors
    /// When the port is taken or needs rights.
    pub fn bind(page: LivePage, port: u16) -> Result<Self, ServeError> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let failed = |cause| ServeError { address, cause };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let seen = Seen {
            state: page.state(),
            running: page.is_running(),
            problem: None,
        };
        let shared = Arc::new(Shared {
            html: page.html().into_bytes(),
            page: Mutex::new(Followed {
                page,
                next: Instant::now(),
            }),
            state: Mutex::new(seen),
            connections: AtomicUsize::new(0),
            stopped: AtomicBool::new(false),
        });
        Ok(Self {
            listener,
            address,
            shared,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What stops it.
    pub fn stopper(&self) -> Stopper {
        Stopper {
            address: self.address,
            shared: Arc::clone(&self.shared),
        }
    }

    /// Answers until it is stopped.
    pub fn run(self) {
        for stream in self.listener.incoming() {
            if self.shared.stopped.load(Ordering::SeqCst) {
                return;
            }
            match stream {
                Ok(stream) => self.accept(stream),
                Err(_) => thread::sleep(PAUSE),
            }
        }
    }

    fn accept(&self, stream: TcpStream) {
        let connection = Connection::open(&self.shared);
        let shared = Arc::clone(&self.shared);
        let answer = move || {
            let response = match connection {
                Some(_) => match Request::read(&stream) {
                    Ok(request) => (shared.answer(&request), request.wants_body()),
                    Err(refusal) => (refusal, true),
                },
                None => (
                    Response::words(
                        Status::Unavailable,
                        "too many connections at a time; ask again later",
                    ),
                    true,
                ),
            };
            // A client that has gone needs no answer.
            let _ = response.0.write(&stream, response.1);
        };
        // Without a thread the connection closes, and the page asks again.
        let _ = thread::Builder::new().spawn(answer);
    }
}

impl Stopper {
    /// Ends [`Server::run`]. Answers on their way may be cut off.
    pub fn stop(&self) {
        self.shared.stopped.store(true, Ordering::SeqCst);
        // Wakes the thread that waits for a connection.
        let _ = TcpStream::connect(self.address);
    }
}

/// A counted connection.
struct Connection(Arc<Shared>);

impl Connection {
    /// Counts a connection; none if there are too many.
    fn open(shared: &Arc<Shared>) -> Option<Self> {
        let connection = Self(Arc::clone(shared));
        (shared.connections.fetch_add(1, Ordering::SeqCst) < MAX_CONNECTIONS).then_some(connection)
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Shared {
    /// The answer to a request.
    fn answer(&self, request: &Request) -> Response {
        match request.path() {
            "/" => Response::page(&self.html),
            "/data/version" => {
                let Seen {
                    state,
                    running,
                    problem,
                } = self.look();
                let (done, planned) = state.counts();
                let version = json!({
                    "version": state.version(), "simulations": done, "planned": planned,
                    "running": running, "problem": problem,
                });
                Response::data(Content::Plain(version.to_string().into_bytes()))
            }
            "/data/index" => Response::data(Content::Packed(self.seen().state.index().to_vec())),
            path => match path
                .strip_prefix("/data/")
                .map(|name| self.seen().state.part(name))
            {
                Some(Ok(Some(part))) => Response::data(Content::Packed(part)),
                Some(Ok(None)) | None => Response::words(Status::NotFound, "there is no such page"),
                Some(Err(error)) => Response::words(Status::Failed, &error.to_string()),
            },
        }
    }

    /// The present data. Looks at the folders unless that was just done, or another connection is
    /// doing it.
    fn look(&self) -> Seen {
        let mut followed = match self.page.try_lock() {
            Ok(followed) => followed,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return self.seen().clone(),
        };
        let begun = Instant::now();
        if begun >= followed.next {
            let refreshed = followed.page.refresh();
            let running = followed.page.is_running();
            followed.next = Instant::now() + REFRESH.max(begun.elapsed() * REST);
            let mut seen = self.seen();
            match refreshed {
                Ok(state) => {
                    *seen = Seen {
                        state,
                        running,
                        problem: None,
                    }
                }
                Err(error) => (seen.running, seen.problem) = (running, Some(error.to_string())),
            }
        }
        self.seen().clone()
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
