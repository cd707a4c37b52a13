//! Flags of whatever can be watched live.

use clap::Args;
use wire::Endpoint;

/// Address of `--view` without one.
pub(super) const VIEW_ADDRESS: &str = "127.0.0.1:8765";

/// Address of `--metrics` without one.
const METRICS_ADDRESS: &str = "127.0.0.1:9464";

/// Flags of the fan-out.
#[derive(Clone, Debug, Default, Args)]
pub struct ForwardArgs {
    /// Forwards the vehicle's messages to a ground station, udpout:HOST:PORT; may be repeated. Of
    /// the station's messages, the vehicle gets those that forward.allow names in the
    /// configuration: none by default.
    #[arg(long, value_name = "URL")]
    pub forward: Vec<Endpoint>,
}

/// Flags of the service's endpoints.
#[derive(Clone, Debug, Default, Args)]
pub struct ServiceArgs {
    /// Serves /health, /status and Prometheus' /metrics, read-only, on an address of this machine
    /// alone [default address: 127.0.0.1:9464].
    #[arg(
        long,
        value_name = "HOST:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = METRICS_ADDRESS,
        value_parser = metrics_address
    )]
    pub metrics: Option<String>,
}

/// Flags of the live view.
#[derive(Clone, Debug, Default, Args)]
pub struct ViewArgs {
    /// Serves a live view: a page for a browser, and at the same address Foxglove's WebSocket
    /// protocol [default address: 127.0.0.1:8765].
    #[arg(
        long,
        value_name = "HOST:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = VIEW_ADDRESS,
        value_parser = view_address
    )]
    pub view: Option<String>,
}

/// Flags of the live view of what is flown.
#[derive(Clone, Debug, Default, Args)]
pub struct FlightViewArgs {
    /// The view itself.
    #[command(flatten)]
    pub watch: ViewArgs,
    /// Lets viewers move the goal and scale the feedback, within offboard.adjustment of the
    /// configuration and where the supervisor allows it; each change is in the log.
    #[arg(long, requires = "view")]
    pub view_write: bool,
}

/// Reads an address of `--view`.
pub(super) fn view_address(text: &str) -> Result<String, String> {
    address(text, VIEW_ADDRESS)
}

fn metrics_address(text: &str) -> Result<String, String> {
    address(text, METRICS_ADDRESS)
}

/// `HOST:PORT` of a text that may leave the host or the port out; `usual` gives what it lacks.
fn address(text: &str, usual: &str) -> Result<String, String> {
    let (usual_host, usual_port) = usual.split_once(':').unwrap_or((usual, "0"));
    // A host name of digits alone would be read as an IPv4 address.
    let digits = text.strip_prefix('-').unwrap_or(text);
    let is_number = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    let (host, port) = match text.rsplit_once(':') {
        _ if text.ends_with(']') => (text, usual_port),
        Some(both) => both,
        None if is_number => ("", text),
        None => (text, usual_port),
    };
    if port.parse::<u16>().is_err() {
        return Err(format!("expected a port from 0 to 65535, found {port:?}"));
    }
    if host.contains(':') && !(host.starts_with('[') && host.ends_with(']')) {
        return Err(format!("expected an IPv6 address in brackets, as in [::1]:{usual_port}"));
    }
    Ok(format!("{}:{port}", if host.is_empty() { usual_host } else { host }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_host_and_port_have_defaults() {
        for (text, expected) in [
            ("9000", "127.0.0.1:9000"),
            (":9000", "127.0.0.1:9000"),
            ("0.0.0.0", "0.0.0.0:8765"),
            ("[::1]", "[::1]:8765"),
            ("[::1]:9000", "[::1]:9000"),
            ("lab:0", "lab:0"),
        ] {
            assert_eq!(view_address(text).as_deref(), Ok(expected), "{text}");
        }
    }

    #[test]
    fn impossible_port_is_not_taken_for_a_host() {
        for text in ["99999", ":99999", "127.0.0.1:99999", "-1", "lab:", "lab:http", "::1"] {
            assert!(metrics_address(text).is_err(), "{text}");
        }
    }
}
