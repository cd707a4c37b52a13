//! Flags of whatever can be watched live.

use clap::Args;
use wire::Endpoint;

/// Address of `--view` without one.
pub const VIEW_ADDRESS: &str = "127.0.0.1:8765";

/// Address of `--metrics` without one.
pub const METRICS_ADDRESS: &str = "127.0.0.1:9464";

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
        default_missing_value = METRICS_ADDRESS
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
        default_missing_value = VIEW_ADDRESS
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
