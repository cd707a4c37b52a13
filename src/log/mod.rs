//! The flight log: what may be logged, the MCAP file, and reading it back.
//!
//! | Topic | Schema | Rate | Frame |
//! |---|---|---|---|
//! | `/mavlink/rx`, `/mavlink/tx` | `downwash.MavlinkFrame` | every frame | as on the wire |
//! | `/state`, `/reference`, `/setpoint`, `/control` | `downwash.*` | every control tick | NED, FRD |
//! | `/imu`, `/actuators`, `/battery` | `downwash.*` | as received | FRD |
//! | `/link/stats`, `/timesync` | `downwash.*` | as reported | |
//! | `/sim/truth` | `downwash.Truth` | as reported by the simulator | NED, FRD |
//! | `/flight/*` | `downwash.*Sample` | native rates of an imported log, which has only these and `/sim/truth` | NED, FRD |
//! | `/tf`, `/vehicle/pose`, `/reference/pose` | `foxglove.*` | at most 55 Hz | ENU `map`, FLU `base_link` |
//! | `/scene` | `foxglove.SceneUpdate` | once | FLU |
//! | `/log` | `foxglove.Log` | every event | |
//!
//! `log_time` is the host time of a record, `publish_time` the vehicle's time of the sample mapped
//! to the host clock. A component that is not known is NaN.

pub mod descriptor;
pub mod encoder;
pub mod export;
mod flights;
pub mod import;
pub mod info;
mod lengths;
mod mcap_file;
pub mod name;
pub mod partial;
pub mod reader;
pub mod record;
pub mod schema;
pub mod sink;
pub mod viewer;
pub mod writer;

pub use reader::LogReader;
pub use record::Record;
pub use sink::LogSink;
pub use writer::{LogWriter, RunInfo};
