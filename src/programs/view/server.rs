//! Sockets: accepts connections on one address, one thread per connection, and ends when told to.
//!
//! A slow or silent client holds only its own thread, and not for longer than [`HEAD_TIME`]; beyond
//! [`MAX_CONNECTIONS`] newcomers are turned away, so that neither memory nor threads run out. A
//! panic in a handler costs its connection alone.

use super::http::{MAX_HEAD, Request, Response, parse};
use crate::error::{Error, Result};
use std::io::{ErrorKind, Read};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Connections served at the same time; a browser opens about six.
pub const MAX_CONNECTIONS: usize = 64;
/// Time in which a request's head must arrive, and for which an idle connection is kept.
pub const HEAD_TIME: Duration = Duration::from_secs(10);
/// How often a waiting connection looks whether the server is stopping.
const GLANCE: Duration = Duration::from_millis(200);
/// Longest time without progress while a response is written.
const WRITE_TIME: Duration = Duration::from_secs(30);
/// Time given to connections to end once the server stops.
const GRACE: Duration = Duration::from_secs(3);
/// Ports tried after the preferred one if none was asked for.
const PORTS_TRIED: u16 = 20;

/// Answers requests; called from many threads.
pub type Handler = Arc<dyn Fn(&Request) -> Response + Send + Sync>;

/// A bound server.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    shared: Arc<Shared>,
}

struct Shared {
    hosts: Vec<String>,
    handler: Handler,
    stopping: AtomicBool,
    connections: AtomicUsize,
}

/// Stops a server from another thread.
#[derive(Clone)]
pub struct Stopper {
    address: SocketAddr,
    shared: Arc<Shared>,
}

impl Stopper {
    /// Tells the server to end; returns whether it had been told before.
    pub fn stop(&self) -> bool {
        let before = self.shared.stopping.swap(true, Ordering::SeqCst);
        // the server waits in accept(): a connection from here wakes it
        drop(TcpStream::connect_timeout(
            &self.address,
            Duration::from_secs(1),
        ));
        before
    }
}

impl Server {
    /// Binds `ip` at `port`, or, without one, at `preferred` or one of the ports after it.
    ///
    /// # Errors
    /// If no port can be had.
    pub fn bind(ip: IpAddr, port: Option<u16>, preferred: u16, handler: Handler) -> Result<Self> {
        let candidates = port.map_or(preferred..=preferred + PORTS_TRIED, |p| p..=p);
        let mut last = None;
        for candidate in candidates {
            match TcpListener::bind((ip, candidate)) {
                Ok(listener) => return Self::new(listener, handler),
                Err(e) => last = Some(e),
            }
        }
        let why = last.map_or_else(String::new, |e| format!(" ({e})"));
        let place = port.unwrap_or(preferred);
        Err(Error::Failed(format!(
            "cannot listen on {ip}, port {place}{why}: give another --port, or another --bind"
        )))
    }

    fn new(listener: TcpListener, handler: Handler) -> Result<Self> {
        let address = listener.local_addr().map_err(|e| Error::io("socket", e))?;
        let shared = Shared {
            hosts: hosts_of(address),
            handler,
            stopping: AtomicBool::new(false),
            connections: AtomicUsize::new(0),
        };
        Ok(Self {
            listener,
            address,
            shared: Arc::new(shared),
        })
    }

    /// The address in a browser's terms.
    #[must_use]
    pub fn url(&self) -> String {
        let everywhere = self.address.ip().is_unspecified();
        if everywhere {
            format!("http://localhost:{}/", self.address.port())
        } else {
            format!("http://{}/", self.address)
        }
    }

    /// What stops this server.
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        // an unspecified address can be bound but not called
        let mut address = self.address;
        if address.ip().is_unspecified() {
            address.set_ip(if address.is_ipv4() {
                IpAddr::from([127, 0, 0, 1])
            } else {
                std::net::Ipv6Addr::LOCALHOST.into()
            });
        }
        Stopper {
            address,
            shared: self.shared.clone(),
        }
    }

    /// Serves until stopped, then lets running responses finish for a moment.
    pub fn run(self) {
        for stream in self.listener.incoming() {
            if self.shared.stopping.load(Ordering::SeqCst) {
                break;
            }
            // a connection that failed before it began (or no file handles for a moment): the next
            // may do
            let Ok(stream) = stream else {
                std::thread::sleep(Duration::from_millis(20));
                continue;
            };
            let slot = Slot::take(&self.shared);
            let shared = self.shared.clone();
            if slot.number > MAX_CONNECTIONS {
                turn_away(stream);
                continue;
            }
            let spawned = std::thread::Builder::new()
                .name("view".into())
                .spawn(move || {
                    let _slot = slot;
                    serve(stream, &shared);
                });
            // without a thread the connection closes: the browser tries again
            drop(spawned);
        }
        let end = Instant::now() + GRACE;
        while self.shared.connections.load(Ordering::SeqCst) > 0 && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// The values of `Host` under which the server at `address` may be called.
fn hosts_of(address: SocketAddr) -> Vec<String> {
    let mut names = vec!["localhost".to_owned(), "127.0.0.1".into(), "[::1]".into()];
    if !address.ip().is_unspecified() {
        names.push(if address.is_ipv6() {
            format!("[{}]", address.ip())
        } else {
            address.ip().to_string()
        });
    }
    let port = address.port();
    let mut hosts: Vec<String> = names.iter().map(|n| format!("{n}:{port}")).collect();
    if port == 80 {
        hosts.extend(names);
    }
    hosts
}

/// Counts a connection for as long as it lives.
struct Slot {
    shared: Arc<Shared>,
    number: usize,
}

impl Slot {
    fn take(shared: &Arc<Shared>) -> Self {
        let number = shared.connections.fetch_add(1, Ordering::SeqCst) + 1;
        Self {
            shared: shared.clone(),
            number,
        }
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.shared.connections.fetch_sub(1, Ordering::SeqCst);
    }
}

fn turn_away(mut stream: TcpStream) {
    // the peer's buffer takes these few bytes at once; if not, it is told nothing
    let _ = stream.set_write_timeout(Some(Duration::from_millis(50)));
    let _ = Response::text(
        503,
        "too many connections: close other windows of this page",
    )
    .write(&mut stream, false, false);
    let _ = stream.shutdown(Shutdown::Both);
}

/// Answers the requests of one connection, one after the other.
fn serve(mut stream: TcpStream, shared: &Shared) {
    let configured = stream
        .set_read_timeout(Some(GLANCE))
        .and_then(|()| stream.set_write_timeout(Some(WRITE_TIME)))
        .and_then(|()| stream.set_nodelay(true));
    if configured.is_err() {
        return;
    }
    let mut received = Vec::new();
    loop {
        let (response, accepts_gzip, keep_alive) =
            match read_head(&mut stream, &mut received, shared) {
                Head::Gone => return,
                Head::Bad(response) => (response, false, false),
                Head::Complete(head) => match parse(&head, &shared.hosts) {
                    Err(response) => (response, false, false),
                    Ok(request) => {
                        let answer = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                            (shared.handler)(&request)
                        }));
                        let response = answer.unwrap_or_else(|_| {
                            Response::text(500, "a defect of unbake: please report it")
                        });
                        (response, request.accepts_gzip, request.keep_alive)
                    }
                },
            };
        let keep_alive = keep_alive && !shared.stopping.load(Ordering::SeqCst);
        // a reader that has gone away is its own affair
        if response
            .write(&mut stream, accepts_gzip, keep_alive)
            .is_err()
            || !keep_alive
        {
            let _ = stream.shutdown(Shutdown::Write);
            return;
        }
    }
}

enum Head {
    Complete(Vec<u8>),
    Bad(Response),
    Gone,
}

/// Reads up to the empty line; what follows it stays in `received` for the next request.
fn read_head(stream: &mut TcpStream, received: &mut Vec<u8>, shared: &Shared) -> Head {
    let end = Instant::now() + HEAD_TIME;
    let mut searched = 0;
    loop {
        if let Some(i) = received[searched..]
            .windows(4)
            .position(|w| w == b"\r\n\r\n")
            .map(|i| i + searched)
        {
            let rest = received.split_off(i + 4);
            let mut head = std::mem::replace(received, rest);
            head.truncate(i);
            return Head::Complete(head);
        }
        if received.len() > MAX_HEAD {
            return Head::Bad(Response::text(431, "the request is too long"));
        }
        searched = received.len().saturating_sub(3);
        let mut buffer = [0; 2048];
        match stream.read(&mut buffer) {
            Ok(0) => return Head::Gone,
            Ok(n) => received.extend_from_slice(&buffer[..n]),
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) => {}
            Err(_) => return Head::Gone,
        }
        if shared.stopping.load(Ordering::SeqCst) {
            return Head::Gone;
        }
        if Instant::now() > end {
            return if received.is_empty() {
                Head::Gone
            } else {
                Head::Bad(Response::text(408, "the request did not arrive"))
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn start(handler: Handler) -> (Stopper, u16, std::thread::JoinHandle<()>) {
        let server =
            Server::bind(IpAddr::from([127, 0, 0, 1]), Some(0), 0, handler).expect("binds");
        let (stopper, port) = (server.stopper(), server.address.port());
        (stopper, port, std::thread::spawn(move || server.run()))
    }

    fn echo() -> Handler {
        Arc::new(|r: &Request| Response::text(200, &r.path))
    }

    fn send(port: u16, bytes: &[u8]) -> String {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("connects");
        stream.write_all(bytes).expect("sends");
        let mut answer = String::new();
        let _ = stream.read_to_string(&mut answer);
        answer
    }

    #[test]
    fn requests_are_answered_and_the_server_ends_when_told() {
        let (stopper, port, thread) = start(echo());
        let answer = send(
            port,
            format!("GET /x HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\n\r\n")
                .as_bytes(),
        );
        assert!(
            answer.starts_with("HTTP/1.1 200 OK\r\n") && answer.ends_with("/x\n"),
            "{answer}"
        );
        assert!(
            answer.contains("nosniff") && answer.contains("Content-Security-Policy"),
            "{answer}"
        );
        // two requests in one piece on one connection
        let two = format!(
            "GET /a HTTP/1.1\r\nHost: localhost:{port}\r\n\r\nGET /b HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\n\r\n"
        );
        let answer = send(port, two.as_bytes());
        assert!(
            answer.contains("/a\n") && answer.ends_with("/b\n"),
            "{answer}"
        );
        // an idle connection must not keep the server
        let _idle = TcpStream::connect(("127.0.0.1", port)).expect("connects");
        let begin = Instant::now();
        assert!(!stopper.stop());
        thread.join().expect("ends");
        assert!(begin.elapsed() < GRACE, "{:?}", begin.elapsed());
        assert!(
            TcpStream::connect(("127.0.0.1", port)).is_err(),
            "the port is free again"
        );
    }

    #[test]
    fn one_slow_request_does_not_hold_up_the_others() {
        let handler: Handler = Arc::new(|r: &Request| {
            if r.path == "/slow" {
                std::thread::sleep(Duration::from_millis(1500));
            }
            Response::text(200, &r.path)
        });
        let (stopper, port, thread) = start(handler);
        let request = |path: &str| {
            format!("GET {path} HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\n\r\n")
        };
        let slow_request = request("/slow");
        let slow = std::thread::spawn(move || send(port, slow_request.as_bytes()));
        // a client that never finishes its request
        let mut dripping = TcpStream::connect(("127.0.0.1", port)).expect("connects");
        dripping.write_all(b"GET / HT").expect("sends");
        let begin = Instant::now();
        let many: Vec<_> = (0..20)
            .map(|_| {
                let quick = request("/quick");
                std::thread::spawn(move || send(port, quick.as_bytes()))
            })
            .collect();
        for quick in many {
            assert!(quick.join().expect("answers").ends_with("/quick\n"));
        }
        assert!(
            begin.elapsed() < Duration::from_millis(1400),
            "{:?}",
            begin.elapsed()
        );
        assert!(slow.join().expect("answers").ends_with("/slow\n"));
        stopper.stop();
        thread.join().expect("ends");
    }

    #[test]
    fn garbage_endless_heads_and_panics_cost_only_their_connection() {
        let handler: Handler = Arc::new(|r: &Request| {
            assert!(r.path != "/panic", "for the test");
            Response::text(200, "fine")
        });
        let (stopper, port, thread) = start(handler);
        assert!(
            send(port, b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\r\n\r\n").starts_with("HTTP/1.1 400")
        );
        let endless = format!("GET / HTTP/1.1\r\nX: {}", "a".repeat(MAX_HEAD + 4096));
        let answer = send(port, endless.as_bytes());
        assert!(
            answer.is_empty() || answer.starts_with("HTTP/1.1 431"),
            "{answer}"
        );
        let foreign = send(port, b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
        assert!(foreign.starts_with("HTTP/1.1 403"), "{foreign}");
        let host = format!("Host: localhost:{port}\r\nConnection: close\r\n\r\n");
        assert!(
            send(port, format!("GET /panic HTTP/1.1\r\n{host}").as_bytes())
                .starts_with("HTTP/1.1 500")
        );
        assert!(send(port, format!("GET /x HTTP/1.1\r\n{host}").as_bytes()).ends_with("fine\n"));
        stopper.stop();
        thread.join().expect("ends");
    }

    #[test]
    fn a_flood_of_connections_is_turned_away_and_forgotten() {
        let (stopper, port, thread) = start(echo());
        let idle: Vec<_> = (0..MAX_CONNECTIONS)
            .map(|_| TcpStream::connect(("127.0.0.1", port)).expect("connects"))
            .collect();
        std::thread::sleep(Duration::from_millis(300));
        let request =
            format!("GET /x HTTP/1.1\r\nHost: localhost:{port}\r\nConnection: close\r\n\r\n");
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("connects");
        let mut answer = String::new();
        let _ = stream.read_to_string(&mut answer);
        assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
        drop(idle);
        std::thread::sleep(Duration::from_millis(600));
        assert!(send(port, request.as_bytes()).starts_with("HTTP/1.1 200"));
        stopper.stop();
        thread.join().expect("ends");
    }

    #[test]
    fn a_taken_port_is_named_with_the_cure() {
        let taken = TcpListener::bind(("127.0.0.1", 0)).expect("binds");
        let port = taken.local_addr().expect("address").port();
        let message = Server::bind(IpAddr::from([127, 0, 0, 1]), Some(port), 0, echo())
            .err()
            .expect("taken")
            .to_string();
        assert!(
            message.contains(&port.to_string()) && message.contains("--port"),
            "{message}"
        );
    }

    #[test]
    fn only_this_machines_names_are_hosts() {
        let hosts = hosts_of("127.0.0.1:9000".parse().expect("address"));
        assert!(
            hosts.contains(&"localhost:9000".to_owned())
                && hosts.iter().all(|h| h.ends_with(":9000"))
        );
        assert!(hosts_of("0.0.0.0:80".parse().expect("address")).contains(&"localhost".to_owned()));
        assert!(
            !hosts_of("0.0.0.0:81".parse().expect("address"))
                .iter()
                .any(|h| h.starts_with("0.0.0.0"))
        );
    }
}
