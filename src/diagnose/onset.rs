//! Finds when something changed during a logged flight.

use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::{VehicleError, VehicleParams};

use crate::diagnose::flights::preparation::PreparedFlight;
use crate::onset::cells::Sample;
use crate::onset::change::Change;
use crate::onset::detector::{Detector, Event, Look, Present, Settings};

/// Time between looks at the vehicle's present state, s: the detector's window.
const PRESENT_S: f64 = 30.0;

/// The detector's results on a flight.
#[derive(Clone, Debug)]
pub struct OnsetReport {
    /// Detected changes, in order of time.
    pub changes: Vec<Change>,
    /// The detector's looks, in order of time.
    pub looks: Vec<Look>,
    /// The vehicle's state at each half minute.
    pub present: Vec<Present>,
    /// Examined time, s.
    pub seconds: f64,
}

/// Looks for changes over the airborne time of a flight.
///
/// # Errors
/// A vehicle that the physics rejects.
pub fn changes(
    flight: &PreparedFlight,
    vehicle: &VehicleParams,
    settings: Settings,
) -> Result<OnsetReport, VehicleError> {
    let mut detector = Detector::new(vehicle, settings)?;
    let mut seen =
        OnsetReport { changes: Vec::new(), looks: Vec::new(), present: Vec::new(), seconds: 0.0 };
    for span in &flight.spans {
        seen.seconds += span.end - span.start;
        let mut hear = |event| match event {
            Event::Change(change) => seen.changes.push(*change),
            Event::Look(look) => seen.looks.push(look),
        };
        let mut last_present = span.start;
        for (time, sample) in samples(flight, span) {
            detector.push(time, sample, &mut hear);
            if time >= last_present + PRESENT_S {
                last_present = time;
                seen.present.extend(detector.present());
            }
        }
        detector.push(span.end, Sample::Pause, &mut hear);
        detector.finish(&mut hear);
    }
    Ok(seen)
}

/// The samples of a span, in order of time.
fn samples(flight: &PreparedFlight, span: &std::ops::Range<f64>) -> Vec<(f64, Sample)> {
    let mut all = Vec::new();
    let mut add = |times: &[f64], sample: &dyn Fn(usize) -> Sample| {
        let from = times.partition_point(|time| *time < span.start);
        let to = times.partition_point(|time| *time <= span.end);
        all.extend((from..to).map(|index| (times[index], sample(index))));
    };
    let voltage = flight.voltage.values();
    add(flight.voltage.times(), &|i| Sample::Voltage(voltage[i][0]));
    let position = flight.position.values();
    add(flight.position.times(), &|i| Sample::Position(Ned::from(position[i])));
    let velocity = flight.velocity.values();
    add(flight.velocity.times(), &|i| Sample::Velocity(Ned::from(velocity[i])));
    let attitude = flight.attitude.values();
    add(flight.attitude.times(), &|i| {
        let [w, x, y, z] = attitude[i];
        Sample::Attitude(Attitude { w, x, y, z })
    });
    let rate = flight.body_rate.values();
    add(flight.body_rate.times(), &|i| Sample::BodyRate(Frd::from(rate[i])));
    let force = flight.specific_force.values();
    add(flight.specific_force.times(), &|i| Sample::SpecificForce(Frd::from(force[i])));
    let outputs = flight.outputs.values();
    add(flight.outputs.times(), &|i| Sample::Outputs(outputs[i]));
    all.sort_by(|a: &(f64, Sample), b| a.0.total_cmp(&b.0));
    all
}
