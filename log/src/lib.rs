//! Flight logs. [`import`] reads the logs of PX4 (ULog), ArduPilot (DataFlash) and ground stations
//! (.tlog), tables, and downwash's logs into one [`import::Flight`]: SI units, typed frames, each
//! stream at its own rate on one clock. [`LogWriter`] and [`LogReader`] write and read downwash's
//! log, an MCAP file.
//!
//! ```
//! use std::path::Path;
//!
//! let table = std::env::temp_dir().join(format!("log-example-{}.csv", std::process::id()));
//! let header = "t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,m1,m2,m3,m4,vbat\n";
//! let values = "1,2,3,0,0,0,0,0,0,1,0,0,0,0.5,0.5,0.5,0.5,3.9";
//! let row = |at: u32| format!("{},{values}\n", f64::from(at) * 0.01);
//! std::fs::write(&table, header.to_owned() + &(0..100).map(row).collect::<String>())?;
//!
//! // The shipped mapping names the columns and states that the table's world has z up.
//! let flight = downwash_log::import::open(&table, Some(Path::new("motion-capture")))?;
//! assert_eq!(flight.position.values()[0].to_array(), [1.0, -2.0, -3.0]);
//! assert!((flight.position.times()[99] - 0.99).abs() < 1e-9);
//! # std::fs::remove_file(&table)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Topics of downwash's logs:
//!
//! | Topic | Schema | Rate | Frame |
//! |---|---|---|---|
//! | `/mavlink/rx`, `/mavlink/tx` | `downwash.MavlinkFrame` | every frame | as on the wire |
//! | `/state`, `/reference`, `/setpoint`, `/control` | `downwash.*` | every tick | NED, FRD |
//! | `/imu`, `/actuators`, `/battery` | `downwash.*` | as received | FRD |
//! | `/link/stats`, `/timesync` | `downwash.*` | as reported | |
//! | `/sim/truth` | `downwash.Truth` | as reported by the simulator | NED, FRD |
//! | `/flight/*` | `downwash.*Sample` | native rates of an imported log | NED, FRD |
//! | `/tf`, `/vehicle/pose`, `/reference/pose` | `foxglove.*` | at most 55 Hz | ENU, FLU |
//! | `/scene` | `foxglove.SceneUpdate` | once | FLU |
//! | `/log` | `foxglove.Log` | every event | |
//!
//! ENU is the viewer's frame `map`, FLU its frame `base_link`. An imported log has only `/flight/*`
//! and `/sim/truth`.
//!
//! `log_time` is the host time of a record. `publish_time` is the vehicle's time of the sample,
//! mapped to the host clock; it stays constant where a new estimate of the clock would turn it
//! back. An unknown component is NaN.

mod calendar;
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
