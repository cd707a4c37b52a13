//! Lists the contents of flight logs in any supported format:
//!
//!     cargo run --example read_log -- flight.ulg flight.mcap

use std::fmt::Write;
use std::path::Path;

use downwash::log::import;

/// The streams of a log with their rates, and the number of kinds of samples left out.
pub fn describe(log: &Path) -> anyhow::Result<String> {
    let flight = import::open(log, None)?;
    let mut text = format!("{}\n", log.display());
    let streams = [
        ("attitude", flight.attitude.len(), flight.attitude.rate()),
        ("position", flight.position.len(), flight.position.rate()),
        ("body rate", flight.body_rate.len(), flight.body_rate.rate()),
        ("specific force", flight.specific_force.len(), flight.specific_force.rate()),
        ("motor outputs", flight.outputs.len(), flight.outputs.rate()),
        ("setpoints", flight.setpoint.len(), flight.setpoint.rate()),
    ];
    for (name, samples, rate_hz) in streams.into_iter().filter(|(_, samples, _)| *samples > 0) {
        writeln!(text, "  {name}: {samples} samples at {rate_hz:.0} Hz")?;
    }
    // Every sample has its time on one clock, s, and its frame in its type: here north, east, down.
    if let Some((time, position)) = flight.position.iter().last() {
        writeln!(text, "  {time:.2} s: {:.2} m above the origin", -position.down())?;
    }
    writeln!(text, "  left out: {} kinds of samples", flight.left_out.len())?;
    Ok(text)
}

fn main() -> anyhow::Result<()> {
    for log in std::env::args_os().skip(1) {
        print!("{}", describe(Path::new(&log))?);
    }
    Ok(())
}
