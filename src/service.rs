//! A monitor's view of a running flight: `/health`, `/status`, and Prometheus' `/metrics`.
//! Read-only, on this machine alone, from a thread that is separate from control.

mod metrics;

use std::io;
use std::net::SocketAddr;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use schemars::JsonSchema;
use serde::Serialize;
use tokio::net::TcpStream;
use tokio::sync::oneshot;

use crate::clock::HostTime;
use crate::health::{Health, HealthView};
use crate::http::{self, Request, respond};
use crate::station::Status;
use crate::supervisor::FlightState;

/// Age of the status above which the control loop is unhealthy, s.
const AGE_MAX_S: f64 = 2.0;

/// Why nothing is served.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The address is in use, or not one of this machine's.
    #[error("cannot serve metrics on {address}: {source}; choose another with --metrics=HOST:PORT")]
    Bind {
        /// The address as given.
        address: String,
        /// The system's reason.
        source: io::Error,
    },
    /// Others could read it.
    #[error(
        "--metrics {address}: expected a loopback address, such as 127.0.0.1:9464; to serve \
         others, put a proxy that controls access in front of it"
    )]
    Open {
        /// The address that it resolves to.
        address: SocketAddr,
    },
    /// The system provides no thread.
    #[error("cannot start serving metrics: {0}")]
    Start(#[from] io::Error),
}

/// The latest status and health.
#[derive(Clone, Debug, Default)]
struct Shown {
    status: Status,
    /// Age of the status when it was shown, s.
    age_s: f64,
    at: Option<Instant>,
    health: Health,
}

impl Shown {
    /// Present age of this status, s.
    fn age_s(&self) -> Option<f64> {
        self.at.map(|at| self.age_s + at.elapsed().as_secs_f64())
    }
}

/// The present state of a flight: the JSON of `GET /status`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct ServiceStatus {
    schema: &'static str,
    schema_version: u32,
    version: &'static str,
    /// Age of this status, s; null before the control loop's first.
    age_s: Option<f64>,
    /// State of the link: searching, connected, stale, lost.
    link: &'static str,
    /// The vehicle's autopilot, once identified.
    vehicle: Option<&'static str>,
    /// The state of the flight.
    #[schemars(with = "Option<String>")]
    state: Option<FlightState>,
    /// The vehicle's mode, by name where the autopilot's profile has one.
    mode: Option<String>,
    /// Whether the motors are armed.
    armed: Option<bool>,
    /// North, east, down, m.
    position_m: [f64; 3],
    /// Distance from the reference, m.
    tracking_error_m: f64,
    /// Remaining charge, 0..1.
    battery: Option<f64>,
    /// Number of setpoints sent.
    setpoints: u64,
    /// Whether records reach the log.
    is_logging_well: bool,
    /// Changes of the vehicle that the monitor reported, and the newest of them as a message.
    changes: u64,
    latest_change: Option<String>,
}

/// A running server; dropping it stops it.
pub struct Service {
    address: SocketAddr,
    shown: Arc<Mutex<Shown>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

fn lock(shown: &Mutex<Shown>) -> MutexGuard<'_, Shown> {
    shown.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Service {
    /// Serves on `HOST:PORT`; port 0 takes a free port of the system's choice.
    ///
    /// # Errors
    /// [`ServiceError`].
    pub fn start(address: &str) -> Result<Self, ServiceError> {
        let address = address.to_owned();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let shown = Arc::new(Mutex::new(Shown::default()));
        let shared = Arc::clone(&shown);
        let (stop, stopped) = oneshot::channel();
        let (started, start) = sync_channel(1);
        let serve = async move {
            let listening = async {
                let listener = http::bind(&address)
                    .await
                    .map_err(|source| ServiceError::Bind { address, source })?;
                let at = listener.local_addr()?;
                match at.ip().is_loopback() {
                    true => Ok((listener, at)),
                    false => Err(ServiceError::Open { address: at }),
                }
            };
            match listening.await {
                Err(error) => drop(started.send(Err(error))),
                Ok((listener, at)) => {
                    if started.send(Ok(at)).is_ok() {
                        tokio::select! {
                            () = http::serve(listener, |stream| answer(stream, Arc::clone(&shared))) => {}
                            _ = stopped => {}
                        }
                    }
                }
            }
        };
        let thread =
            thread::Builder::new().name("service".into()).spawn(move || runtime.block_on(serve))?;
        let address =
            start.recv().map_err(|_| io::Error::other("its thread ended before it started"))??;
        Ok(Self { address, shown, stop: Some(stop), thread: Some(thread) })
    }

    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Takes the flight's status at `now`.
    pub fn show(&self, now: HostTime, status: &Status, health: Option<&HealthView>) {
        // Before the control loop's first status there is no age.
        let Some(updated) = status.updated else { return };
        let age_s = now.since(updated).as_secs_f64();
        let health = health.map(HealthView::get).unwrap_or_default();
        *lock(&self.shown) =
            Shown { status: status.clone(), age_s, at: Some(Instant::now()), health };
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

async fn answer(mut stream: TcpStream, shown: Arc<Mutex<Shown>>) -> io::Result<()> {
    let request = Request::read(&mut stream).await?;
    let shown = lock(&shown).clone();
    let (status, kind, body) = match &request {
        None => ("400 Bad Request", "text/plain", "no HTTP\n".to_owned()),
        Some(Request { is_get: false, .. }) => {
            ("405 Method Not Allowed", "text/plain", "only GET is supported\n".to_owned())
        }
        Some(Request { path, .. }) => match path.as_str() {
            "/health" => health(&shown),
            "/status" => ("200 OK", "application/json", status_json(&shown)),
            "/metrics" => (
                "200 OK",
                "text/plain; version=0.0.4",
                metrics::text(&shown.status, shown.health.count, shown.age_s()),
            ),
            _ => {
                let text = "not found; try /health, /status or /metrics\n".to_owned();
                ("404 Not Found", "text/plain", text)
            }
        },
    };
    respond(&mut stream, status, kind, &body).await
}

/// 200 while the control loop runs. The body names a log that fails; a restart would not fix that.
fn health(shown: &Shown) -> (&'static str, &'static str, String) {
    const NOT_WELL: &str = "503 Service Unavailable";
    let (status, text) = match shown.age_s() {
        None => (NOT_WELL, "the control loop has not started\n".to_owned()),
        Some(age_s) if age_s > AGE_MAX_S => {
            (NOT_WELL, format!("the control loop has not run for {age_s:.1} s\n"))
        }
        Some(_) if !is_logging_well(&shown.status) => {
            ("200 OK", "ok, but the log is not written or lacks records\n".to_owned())
        }
        Some(_) => ("200 OK", "ok\n".to_owned()),
    };
    (status, "text/plain", text)
}

fn is_logging_well(status: &Status) -> bool {
    status.log_failures == 0 && status.log_dropped == 0
}

fn status_json(shown: &Shown) -> String {
    let status = &shown.status;
    let named = status.mode_name.map(str::to_owned);
    let document = ServiceStatus {
        schema: "downwash.status",
        schema_version: 1,
        version: env!("CARGO_PKG_VERSION"),
        age_s: shown.age_s(),
        link: if status.link.is_empty() { "searching" } else { status.link },
        vehicle: status.vehicle,
        state: status.phase,
        mode: named.or_else(|| status.mode.map(|word| word.to_string())),
        armed: status.armed,
        position_m: status.position.to_array(),
        tracking_error_m: status.tracking_error_m,
        battery: status.battery,
        setpoints: status.setpoints,
        is_logging_well: is_logging_well(status),
        changes: shown.health.count,
        latest_change: shown.health.latest.clone(),
    };
    serde_json::to_string(&document).unwrap_or_default() + "\n"
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net;
    use std::time::Duration;

    use super::*;

    fn exchange(service: &Service, request: &str) -> String {
        let mut stream = net::TcpStream::connect(service.address()).expect("it listens");
        stream.write_all(request.as_bytes()).expect("open");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("text");
        answer
    }

    fn get(service: &Service, path: &str) -> String {
        exchange(service, &format!("GET {path} HTTP/1.1\r\nHost: a\r\n\r\n"))
    }

    #[test]
    fn health_is_ok_only_while_updates_arrive() {
        let service = Service::start("127.0.0.1:0").expect("loopback");
        assert!(get(&service, "/health").starts_with("HTTP/1.1 503"));
        let now = HostTime::from_ns(10_000_000_000);
        let running = Status { updated: Some(now), setpoints: 7, ..Status::default() };
        service.show(now, &running, None);
        assert!(get(&service, "/health").ends_with("\r\n\r\nok\n"));
        let metrics = get(&service, "/metrics");
        assert!(metrics.contains("text/plain; version=0.0.4"), "{metrics}");
        assert!(metrics.contains("\ndownwash_setpoints_total 7\n"), "{metrics}");
        let document: serde_json::Value =
            serde_json::from_str(get(&service, "/status").split("\r\n\r\n").nth(1).expect("body"))
                .expect("JSON");
        assert_eq!(
            (&document["schema"], &document["setpoints"]),
            (&"downwash.status".into(), &7.into())
        );
        let blind = Status { log_failures: 1, ..running.clone() };
        service.show(now, &blind, None);
        let answer = get(&service, "/health");
        assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("log"), "{answer}");
        service.show(now + Duration::from_secs(3), &running, None);
        assert!(get(&service, "/health").starts_with("HTTP/1.1 503"));
    }

    #[test]
    fn service_is_read_only_and_loopback_only() {
        let service = Service::start("127.0.0.1:0").expect("loopback");
        let post = exchange(&service, "POST /status HTTP/1.1\r\n\r\n");
        assert!(post.starts_with("HTTP/1.1 405"), "{post}");
        assert!(get(&service, "/../etc/passwd").starts_with("HTTP/1.1 404"));
        assert!(exchange(&service, &"A".repeat(9000)).starts_with("HTTP/1.1 400"));
        let open = Service::start("0.0.0.0:0").err().expect("others could read it");
        assert!(open.to_string().contains("expected a loopback address"), "{open}");
        assert!(Service::start(&service.address().to_string()).is_err(), "the port is taken");
    }
}
