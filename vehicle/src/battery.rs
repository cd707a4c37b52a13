//! The battery pack: charge, terminal voltage under load, and current.

use serde::{Deserialize, Serialize};

use crate::params::{ROTORS, VehicleParams};

/// Settings of the pack that the vehicle file does not have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BatteryConfig {
    /// Capacity in mAh; by default enough for eight minutes of hover.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capacity_mah: Option<f64>,
    /// Internal resistance in ohm; by default one that drops 4 % of the full voltage at hover.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resistance_ohm: Option<f64>,
    /// Charge at the start, 0..=1.
    pub charge: f64,
}

impl Default for BatteryConfig {
    fn default() -> Self {
        Self { capacity_mah: None, resistance_ohm: None, charge: 1.0 }
    }
}

/// Points (state of charge, open-circuit voltage over the full one) of a lithium polymer cell.
const OPEN_CIRCUIT: [(f64, f64); 9] = [
    (0.0, 0.786),
    (0.05, 0.845),
    (0.1, 0.869),
    (0.2, 0.888),
    (0.4, 0.905),
    (0.6, 0.924),
    (0.8, 0.957),
    (0.9, 0.976),
    (1.0, 1.0),
];

/// Ideal induced power over electrical power at hover, for small rotors and their motors.
const EFFICIENCY: f64 = 0.45;

/// Hover time of a pack with the default capacity, in s.
const DEFAULT_HOVER_TIME: f64 = 480.0;

/// Voltage drop at hover over the full voltage, with the default resistance.
const DEFAULT_HOVER_DROP: f64 = 0.04;

/// Electrical power of the rotors: P = sum T^1.5 / (sqrt(2 rho A) efficiency), from the induced
/// power of momentum theory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerModel {
    coefficient: f64,
}

impl PowerModel {
    /// Creates the model from a vehicle's rotor radius and air density.
    pub fn new(vehicle: &VehicleParams) -> Self {
        let disc = std::f64::consts::PI * vehicle.rotor_radius_m * vehicle.rotor_radius_m;
        Self { coefficient: 1.0 / ((2.0 * vehicle.air_density * disc).sqrt() * EFFICIENCY) }
    }

    /// Power in W for the rotors' thrusts in N.
    #[inline]
    pub fn power(&self, thrusts: &[f64; ROTORS]) -> f64 {
        thrusts.iter().map(|&t| t.max(0.0) * t.max(0.0).sqrt()).sum::<f64>() * self.coefficient
    }
}

/// A pack with an internal resistance and an open-circuit voltage that depends on the charge.
#[derive(Clone, Debug)]
pub struct Battery {
    full_voltage: f64,
    capacity: f64,
    resistance: f64,
    charge: f64,
    voltage: f64,
    current: f64,
    held: Option<f64>,
}

impl Battery {
    /// The vehicle's pack without load. With the default capacity it hovers for eight minutes; with
    /// the default resistance its voltage drops by 4 % in hover.
    pub fn new(vehicle: &VehicleParams, config: &BatteryConfig) -> Self {
        let hover = vehicle.mass * vehicle.gravity / ROTORS as f64;
        let hover_power = PowerModel::new(vehicle).power(&[hover; ROTORS]);
        let hover_current = hover_power / vehicle.battery.nominal_v;
        let full_voltage = vehicle.battery.full_v;
        let capacity =
            config.capacity_mah.map_or(hover_current * DEFAULT_HOVER_TIME, |mah| mah * 3.6);
        let resistance =
            config.resistance_ohm.unwrap_or(DEFAULT_HOVER_DROP * full_voltage / hover_current);
        let charge = config.charge;
        let voltage = full_voltage * open_circuit(charge);
        Self { full_voltage, capacity, resistance, charge, voltage, current: 0.0, held: None }
    }

    /// Holds the terminal voltage at `voltage` (V) from now on, whatever the load, to replay a
    /// logged flight.
    pub fn hold(&mut self, voltage: f64) {
        self.held = Some(voltage);
        self.voltage = voltage;
    }

    /// Drains the pack to `charge`, 0..1, at once; never raises it.
    pub fn drain(&mut self, charge: f64) {
        self.charge = self.charge.min(charge.max(0.0));
    }

    /// Draws `power` (W) for `duration` (s).
    pub fn advance(&mut self, power: f64, duration: f64) {
        (self.voltage, self.current) = match self.held {
            Some(voltage) => (voltage, power / voltage),
            None => self.terminal(power),
        };
        self.charge = (self.charge - self.current * duration / self.capacity).max(0.0);
    }

    /// Terminal voltage (V) and current (A) of the cells at `power` [W].
    fn terminal(&self, power: f64) -> (f64, f64) {
        let open = self.full_voltage * open_circuit(self.charge);
        // V I = P with V = open - R I. A pack delivers its maximum power at half its open-circuit
        // voltage.
        let limit = 0.5 * open;
        let root = (limit * limit - self.resistance * power).max(0.0).sqrt();
        let current =
            if self.resistance > 0.0 { (limit - root) / self.resistance } else { power / open };
        (open - self.resistance * current, current)
    }

    /// Terminal voltage in V, under the last load or as held.
    pub fn voltage(&self) -> f64 {
        self.voltage
    }

    /// Current out of the pack in A.
    pub fn current(&self) -> f64 {
        self.current
    }

    /// Charge left, 0..=1.
    pub fn remaining(&self) -> f64 {
        self.charge
    }
}

/// Open-circuit voltage over the full one, linear between the table's points.
fn open_circuit(charge: f64) -> f64 {
    for pair in OPEN_CIRCUIT.windows(2) {
        let [(c0, v0), (c1, v1)] = [pair[0], pair[1]];
        if charge <= c1 {
            return v0 + (v1 - v0) * ((charge - c0) / (c1 - c0)).max(0.0);
        }
    }
    1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::tests::quad;

    #[test]
    fn voltage_current_and_power_agree() {
        let config = BatteryConfig { resistance_ohm: Some(0.05), ..BatteryConfig::default() };
        let mut battery = Battery::new(&quad(), &config);
        let open = battery.voltage();
        battery.advance(100.0, 1e-3);
        assert!((battery.voltage() * battery.current() - 100.0).abs() < 1e-9);
        assert!((open - battery.voltage() - 0.05 * battery.current()).abs() < 1e-12);
    }

    #[test]
    fn default_pack_hovers_for_about_eight_minutes() {
        let vehicle = quad();
        let mut battery = Battery::new(&vehicle, &BatteryConfig::default());
        let power = PowerModel::new(&vehicle).power(&[vehicle.mass * vehicle.gravity / 4.0; 4]);
        let mut time = 0.0;
        while battery.remaining() > 0.0 {
            battery.advance(power, 1.0);
            time += 1.0;
        }
        assert!((400.0..520.0).contains(&time), "{time} s");
    }

    #[test]
    fn short_circuit_stays_finite() {
        let mut battery = Battery::new(&quad(), &BatteryConfig::default());
        battery.advance(1e12, 1.0);
        assert!(battery.voltage() > 0.0 && battery.current().is_finite());
        assert!(battery.remaining() >= 0.0);
    }
}
