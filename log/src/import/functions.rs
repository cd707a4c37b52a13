//! Finds the outputs that drive motors, from the output functions in the parameters.

use std::collections::{BTreeMap, BTreeSet};

/// Number of motors of a quadrotor.
pub(super) const MOTORS: usize = 4;
/// Largest number of outputs of a device.
pub(super) const OUTPUTS: usize = 16;

/// Prefixes of the parameters of PX4's output devices, in start-up order; other devices follow.
const PX4_DEVICES: [&str; 3] = ["PWM_MAIN", "PWM_AUX", "UAVCAN_EC"];
/// Output function of PX4's first motor.
pub(super) const PX4_MOTOR_1: f64 = 101.0;
/// Output function of ArduPilot's first motor.
const ARDUPILOT_MOTOR_1: f64 = 33.0;
/// Output functions of PX4's motors.
const PX4_MOTORS: std::ops::RangeInclusive<u32> = 101..=112;
/// Output functions of ArduPilot's motors 1 to 8 and 9 to 12.
const ARDUPILOT_MOTORS: [std::ops::RangeInclusive<u32>; 2] = [33..=40, 82..=85];
/// Number of ArduPilot's outputs.
const ARDUPILOT_OUTPUTS: usize = 32;
/// An output that changes in less than this share of the samples does not move.
const MOVES: f64 = 0.05;

/// A PX4 output device with its output functions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Device {
    /// Prefix of its parameters.
    pub name: String,
    /// Function of each output.
    functions: [Option<f64>; OUTPUTS],
}

impl Device {
    /// The outputs of motors 1 to 4, counted from 0.
    fn motors(&self) -> [Option<usize>; MOTORS] {
        std::array::from_fn(|motor| {
            self.functions.iter().position(|f| *f == Some(PX4_MOTOR_1 + motor as f64))
        })
    }
}

/// The PX4 devices whose output functions are in the parameters.
fn px4_devices(parameters: &BTreeMap<String, f64>) -> Vec<Device> {
    let mut stated: BTreeMap<&str, [Option<f64>; OUTPUTS]> = BTreeMap::new();
    for (name, function) in parameters {
        let Some((device, number)) = name.rsplit_once("_FUNC") else { continue };
        let output = number.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
        let Some(output) = output.filter(|output| *output < OUTPUTS) else { continue };
        stated.entry(device).or_default()[output] = Some(*function);
    }
    let device = |(name, functions): (&str, _)| Device { name: name.to_owned(), functions };
    let mut devices: Vec<Device> = stated.into_iter().map(device).collect();
    let order = |device: &Device| PX4_DEVICES.iter().position(|name| *name == device.name);
    devices.sort_by_key(|device| order(device).unwrap_or(PX4_DEVICES.len()));
    devices
}

/// Detects which outputs of a device move. Motor outputs change from sample to sample in flight; an
/// output that only switches between disarmed and armed does not.
#[derive(Clone, Debug, Default)]
pub(super) struct Movement {
    samples: usize,
    last: Option<[f64; OUTPUTS]>,
    changes: [usize; OUTPUTS],
    /// Number of outputs of the device.
    count: usize,
}

impl Movement {
    /// For a device with `count` outputs.
    pub fn of(count: usize) -> Self {
        Self { count, ..Self::default() }
    }

    /// Adds the next sample.
    pub fn add(&mut self, outputs: [f64; OUTPUTS]) {
        self.samples += 1;
        if let Some(last) = self.last.replace(outputs) {
            for ((changes, last), now) in self.changes.iter_mut().zip(last).zip(outputs) {
                *changes += usize::from(now != last);
            }
        }
    }

    fn moves(&self, output: usize) -> bool {
        let changes = self.changes.get(output).copied().unwrap_or(0);
        output < self.count && changes > 2 && changes as f64 > MOVES * self.samples as f64
    }
}

/// The outputs that drive motors 1 to 4.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drive {
    /// Index of the device among those logged.
    pub index: usize,
    /// Outputs of the device, counted from 0.
    pub channels: [usize; MOTORS],
    /// Prefix of the device's parameters; `None` if no parameter states the mapping.
    pub device: Option<String>,
}

impl Drive {
    /// Source of the mapping, for people.
    pub fn reason(&self) -> String {
        match &self.device {
            Some(device) => format!("by {device}_FUNCn"),
            None => {
                "as no parameter states which output drives which motor: the first device is used \
                 whose outputs 1 to 4 all move"
                    .to_owned()
            }
        }
    }
}

/// The outputs that drive PX4's motors, among the logged devices. A log does not identify its
/// devices; the clues are their start-up order, that motors move in flight, and that outputs
/// without a function do not.
///
/// # Errors
/// Why there are none, for people.
pub(super) fn px4_drive(
    parameters: &BTreeMap<String, f64>,
    logged: &[Movement],
) -> Result<Drive, String> {
    let devices = px4_devices(parameters);
    let driving = devices.iter().enumerate().filter_map(|(at, device)| {
        let [Some(a), Some(b), Some(c), Some(d)] = device.motors() else { return None };
        Some(Driving { at, device, channels: [a, b, c, d] })
    });
    let driving: Vec<Driving<'_>> = driving.collect();
    let Some(first) = driving.first() else {
        if !devices.is_empty() {
            let split = devices.iter().filter(|device| device.motors().iter().any(Option::is_some));
            let names: Vec<&str> = split.map(|device| device.name.as_str()).collect();
            return Err(match names.as_slice() {
                [] => "no output function that the parameters state is a motor's".to_owned(),
                names => format!(
                    "no device drives all of motors 1 to 4: some are on {}",
                    names.join(", ")
                ),
            });
        }
        let channels = [0, 1, 2, 3];
        let all_move = |m: &Movement| channels.iter().all(|channel| m.moves(*channel));
        let index = logged.iter().position(all_move).unwrap_or(0);
        return Ok(Drive { index, channels, device: None });
    };
    // A device may have motor functions and drive nothing, as PWM outputs beside ESCs on a bus.
    let pairs = driving.iter().rev().flat_map(|driving| {
        logged.iter().enumerate().rev().map(move |(index, movement)| (driving, index, movement))
    });
    let best = pairs.max_by_key(|(driving, index, movement)| driving.score(*index, movement));
    let (driving, index) = best.map_or((first, 0), |(driving, index, _)| (driving, index));
    let Driving { device, channels, .. } = *driving;
    Ok(Drive { index, channels, device: Some(device.name.clone()) })
}

/// A device whose functions include all motors.
#[derive(Clone, Copy)]
struct Driving<'a> {
    /// Place among the devices, in start-up order.
    at: usize,
    device: &'a Device,
    /// Its outputs of motors 1 to 4, counted from 0.
    channels: [usize; MOTORS],
}

impl Driving<'_> {
    /// How well a logged device agrees with this one; the larger, the better.
    fn score(&self, index: usize, movement: &Movement) -> (bool, usize, bool, usize) {
        let motors = self.channels.iter().filter(|channel| movement.moves(**channel)).count();
        let idle = |(_, function): &(usize, &Option<f64>)| **function == Some(0.0);
        let idle = self.device.functions.iter().enumerate().filter(idle);
        let still = idle.filter(|(output, _)| !movement.moves(*output)).count();
        (motors == MOTORS, still, index == self.at, motors)
    }
}

/// Number of motors with an output, by the functions that the parameters state; `None` unless it is
/// more than a quadrotor has, as a log may lack parameters.
pub(super) fn more_motors(parameters: &BTreeMap<String, f64>) -> Option<u32> {
    let px4 = px4_devices(parameters).into_iter().flat_map(|device| device.functions).flatten();
    let px4 = px4.map(|function| function as u32).filter(|f| PX4_MOTORS.contains(f));
    let ardupilot = (0..ARDUPILOT_OUTPUTS).filter_map(|at| ardupilot_function(parameters, at));
    let ardupilot = ardupilot.map(|function| function as u32);
    let ardupilot = ardupilot.filter(|f| ARDUPILOT_MOTORS.iter().any(|motors| motors.contains(f)));
    let motors = px4.chain(ardupilot).collect::<BTreeSet<u32>>().len();
    (motors > MOTORS).then_some(motors as u32)
}

/// The function of an output of ArduPilot, counted from 0.
fn ardupilot_function(parameters: &BTreeMap<String, f64>, at: usize) -> Option<f64> {
    parameters.get(&format!("SERVO{}_FUNCTION", at + 1)).copied()
}

/// Motor mapping in ArduPilot's parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Stated {
    /// No output functions: before ArduCopter 3.5, outputs 1 to 4 drive motors 1 to 4.
    Nothing,
    /// The outputs of motors 1 to 4, counted from 0.
    Motors([usize; MOTORS]),
    /// Output functions exist, but not for these motors, counted from 1.
    Without(Vec<usize>),
}

/// The outputs that drive ArduPilot's motors 1 to 4 (SERVOn_FUNCTION).
pub(super) fn ardupilot_motors(parameters: &BTreeMap<String, f64>) -> Stated {
    let function = |at: usize| ardupilot_function(parameters, at);
    if (0..ARDUPILOT_OUTPUTS).all(|at| function(at).is_none()) {
        return Stated::Nothing;
    }
    let output = |motor: usize| {
        let function_code = Some(ARDUPILOT_MOTOR_1 + motor as f64);
        (0..ARDUPILOT_OUTPUTS).find(|at| function(*at) == function_code)
    };
    let outputs: [Option<usize>; MOTORS] = std::array::from_fn(output);
    match outputs {
        [Some(a), Some(b), Some(c), Some(d)] => Stated::Motors([a, b, c, d]),
        outputs => {
            let missing = (0..MOTORS).filter(|motor| outputs[*motor].is_none());
            Stated::Without(missing.map(|motor| motor + 1).collect())
        }
    }
}

/// Formats output numbers, counted from 1, for people.
pub(super) fn numbered(outputs: &[usize]) -> String {
    let numbers: Vec<String> = outputs.iter().map(|output| (output + 1).to_string()).collect();
    numbers.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters(named: &[(&str, f64)]) -> BTreeMap<String, f64> {
        named.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
    }

    /// A device whose outputs in `moving` move.
    fn logged(moving: &[usize]) -> Movement {
        let mut movement = Movement::of(8);
        for step in 0..50 {
            let value = |at: usize| if moving.contains(&at) { f64::from(step) } else { 900.0 };
            movement.add(std::array::from_fn(value));
        }
        movement
    }

    fn motors(device: &str) -> Vec<(String, f64)> {
        (1..=8)
            .map(|n| (format!("{device}_FUNC{n}"), if n < 5 { 100.0 + f64::from(n) } else { 0.0 }))
            .collect()
    }

    #[test]
    fn motors_are_on_the_device_whose_functions_and_movement_agree() {
        let mut stated: BTreeMap<String, f64> = motors("PWM_AUX").into_iter().collect();
        stated.extend((1..=8).map(|n| (format!("PWM_MAIN_FUNC{n}"), 0.0)));
        let found = |logged: &[Movement]| px4_drive(&stated, logged).map(|drive| drive.index);
        let (gimbal, quad) = (logged(&[0]), logged(&[0, 1, 2, 3]));
        assert_eq!(found(&[gimbal.clone(), quad.clone()]), Ok(1));
        // Independent of the order in which the devices started.
        assert_eq!(found(&[quad.clone(), gimbal]), Ok(0));
        // Servos on the first four of MAIN move too: the order of the devices decides.
        stated.extend((1..=4).map(|n| (format!("PWM_MAIN_FUNC{n}"), 200.0 + f64::from(n))));
        assert_eq!(px4_drive(&stated, &[quad.clone(), quad]).map(|drive| drive.index), Ok(1));
    }

    #[test]
    fn device_that_moves_is_taken_where_two_have_motor_functions() {
        let stated: BTreeMap<String, f64> =
            motors("PWM_MAIN").into_iter().chain(motors("UAVCAN_EC")).collect();
        let found = |logged: &[Movement]| {
            let drive = px4_drive(&stated, logged).expect("a drive");
            (drive.index, drive.device.expect("a device"))
        };
        let (still, quad) = (logged(&[]), logged(&[0, 1, 2, 3]));
        assert_eq!(found(&[still.clone(), quad.clone()]), (1, "UAVCAN_EC".to_owned()));
        assert_eq!(found(&[quad.clone(), still.clone()]), (0, "PWM_MAIN".to_owned()));
        assert_eq!(found(&[quad.clone(), quad]), (0, "PWM_MAIN".to_owned()));
        assert_eq!(found(&[still]), (0, "PWM_MAIN".to_owned()));
    }

    #[test]
    fn first_moving_device_is_used_without_output_functions() {
        let none = BTreeMap::new();
        let drive = px4_drive(&none, &[logged(&[]), logged(&[0, 1, 2, 3])]).expect("a drive");
        assert_eq!((drive.index, drive.device), (1, None));
        assert_eq!(px4_drive(&none, &[logged(&[])]).expect("a drive").index, 0);
    }

    #[test]
    fn missing_or_split_motor_functions_are_reported() {
        let wing = parameters(&[("PWM_MAIN_FUNC1", 201.0)]);
        assert!(px4_drive(&wing, &[logged(&[0])]).unwrap_err().contains("is a motor"));
        let split = parameters(&[("PWM_MAIN_FUNC1", 101.0), ("PWM_AUX_FUNC1", 102.0)]);
        assert!(px4_drive(&split, &[logged(&[0])]).unwrap_err().contains("PWM_MAIN, PWM_AUX"));
    }

    #[test]
    fn functions_show_more_motors_than_a_quadrotor_has() {
        let named = |name: fn(u32) -> String, functions: &[f64]| {
            let named = (1..).zip(functions).map(|(n, function)| (name(n), *function));
            more_motors(&named.collect())
        };
        let servo = |n| format!("SERVO{n}_FUNCTION");
        let quad = [33.0, 34.0, 35.0, 36.0];
        assert_eq!(named(servo, &[&quad[..], &[37.0, 38.0]].concat()), Some(6));
        assert_eq!(named(servo, &[&quad[..], &[1.0, 33.0, 70.0]].concat()), None);
        let main = |n| format!("PWM_MAIN_FUNC{n}");
        assert_eq!(named(main, &[101.0, 102.0, 103.0, 104.0, 105.0, 106.0]), Some(6));
        assert_eq!(named(main, &[101.0, 102.0, 103.0, 104.0, 201.0, 0.0]), None);
    }

    #[test]
    fn ardupilot_motors_follow_servo_functions() {
        let stated: Vec<(String, f64)> =
            (0..4).map(|n| (format!("SERVO{}_FUNCTION", 9 + n), 36.0 - f64::from(n))).collect();
        assert_eq!(ardupilot_motors(&stated.into_iter().collect()), Stated::Motors([11, 10, 9, 8]));
        assert_eq!(ardupilot_motors(&BTreeMap::new()), Stated::Nothing);
        let wing = parameters(&[("SERVO1_FUNCTION", 4.0), ("SERVO3_FUNCTION", 70.0)]);
        assert_eq!(ardupilot_motors(&wing), Stated::Without(vec![1, 2, 3, 4]));
    }
}
