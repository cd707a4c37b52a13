//! Flight logs. [`import`] reads those of PX4 (ULog), ArduPilot (DataFlash), ground stations (.tlog),
//! tables and downwash itself into one [`import::Flight`]: SI units, typed frames, each stream at its
//! own rate on one clock. [`LogWriter`] and [`LogReader`] are downwash's own log, an MCAP file.
//!
//! ```
//! use std::path::Path;
//!
//! let table = std::env::temp_dir().join(format!("log-example-{}.csv", std::process::id()));
//! let header = "t,px,py,pz,vx,vy,vz,qx,qy,qz,qw,wx,wy,wz,m1,m2,m3,m4,vbat\n";
//! let row = |at: u32| format!("{},1,2,3,0,0,0,0,0,0,1,0,0,0,0.5,0.5,0.5,0.5,3.9\n", f64::from(at) * 0.01);
//! std::fs::write(&table, header.to_owned() + &(0..100).map(row).collect::<String>())?;
//!
//! // The shipped mapping says what the columns are, and that the table's world has z up.
//! let flight = downwash_log::import::open(&table, Some(Path::new("motion-capture")))?;
//! assert_eq!(flight.position.values()[0].to_array(), [1.0, -2.0, -3.0]);
//! assert!((flight.position.times()[99] - 0.99).abs() < 1e-9);
//! # std::fs::remove_file(&table)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! What downwash logs:
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
//! to the host clock; it stands still where the clock's estimate would turn it back. A component that is not known is NaN.

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
