//! Fit of the physics' parameters to rows: scale of thrust, drag, inertia, centre of mass, trim,
//! flapping, damping and wind.

use nalgebra::DVector;
use vehicle::effects::{
    AttitudeTrim, BladeFlapping, ComOffset, Effect, EffectSet, Inertia, RotorDrag, Slots,
    ThrustScale, Wind,
};
use vehicle::{VehicleError, VehicleParams};

use super::dataset::Row;
use super::least_squares::{huber, least_squares};
use crate::model::physics::{PhysicsModel, PhysicsParameters};
use crate::model::{ACCELERATIONS, Model};

/// Most rows in the fit of the physics.
const FIT_ROWS: usize = 8_000;
/// Most rows in a fit that continues another.
const CONTINUED_ROWS: usize = 2_000;
/// Number of fitted parameters.
pub(super) const PARAMETERS: usize = 16;
/// Least drag over mass at which a search starts, 1/s: without drag a wind has no force, and the
/// search would never find one.
const DRAG_START_PER_S: f64 = 0.02;
/// Indices of the wind's parameters.
pub(super) const WIND: std::ops::Range<usize> = 14..16;
/// Prior standard deviation of the wind along one axis, m/s: a light breeze.
const WIND_PRIOR_M_S: f64 = 2.0;
/// Strongest wind, m/s.
const WIND_MAX_M_S: f64 = 30.0;

/// Fits the physics: scale of thrust, drag, inertia, centre of mass, trim, damping, flapping and a
/// steady wind that all rows share, each with a weak prior at the vehicle file's value, by
/// Levenberg-Marquardt on the rows' labels, with each acceleration weighted by its standard
/// deviation.
///
/// # Errors
/// The vehicle does not allow the physics.
pub fn fit(rows: &[&Row], vehicle: &VehicleParams) -> Result<PhysicsParameters, VehicleError> {
    search(rows, vehicle, Parameters::shipped(vehicle), FIT_ROWS)
}

/// As [`fit`], but starts at physics that was fitted to some of these rows.
///
/// The vehicle does not allow the physics.
pub(super) fn fit_from(
    rows: &[&Row],
    vehicle: &VehicleParams,
    from: &PhysicsParameters,
) -> Result<PhysicsParameters, VehicleError> {
    search(rows, vehicle, Parameters::fitted(from, vehicle), CONTINUED_ROWS)
}

fn search(
    rows: &[&Row],
    vehicle: &VehicleParams,
    mut from: Parameters,
    most: usize,
) -> Result<PhysicsParameters, VehicleError> {
    let stride = rows.len().div_ceil(most).max(1);
    let rows: Vec<&Row> = rows.iter().step_by(stride).copied().collect();
    let start = Parameters::shipped(vehicle);
    if rows.is_empty() {
        return Ok(start.physics(vehicle));
    }
    let weights = weights(&rows);
    let prior = Parameters::prior(vehicle);
    // Weight of the prior: a deviation of one counts as much as this many rows' residuals of one
    // standard deviation.
    let trust = rows.len() as f64 * 1e-4;

    let residuals = |parameters: &Parameters| -> Result<DVector<f64>, VehicleError> {
        let model = PhysicsModel::new(vehicle, &parameters.physics(vehicle))?;
        let mut out = Vec::with_capacity(rows.len() * ACCELERATIONS + PARAMETERS);
        for row in &rows {
            let predicted = model.accelerations(&row.point);
            for i in 0..ACCELERATIONS {
                out.push(huber((predicted[i] - row.label[i]) * weights[i]));
            }
        }
        let pulled = parameters.0.iter().zip(start.0).zip(prior);
        out.extend(pulled.map(|((now, shipped), prior)| (now - shipped) / prior * trust.sqrt()));
        Ok(DVector::from_vec(out))
    };

    from.0[1] = from.0[1].max(DRAG_START_PER_S * vehicle.mass);
    let fitted = least_squares(from.0, &prior, |numbers| {
        let mut bounded = Parameters(*numbers);
        bounded.bound(vehicle);
        (bounded.0, residuals(&bounded).ok())
    });
    Ok(Parameters(fitted).physics(vehicle))
}

/// The reciprocal standard deviation of each acceleration.
fn weights(rows: &[&Row]) -> [f64; ACCELERATIONS] {
    let count = rows.len() as f64;
    std::array::from_fn(|i| {
        let mean = rows.iter().map(|row| row.label[i]).sum::<f64>() / count;
        let variance = rows.iter().map(|row| (row.label[i] - mean).powi(2)).sum::<f64>() / count;
        1.0 / variance.sqrt().max(1e-6)
    })
}

/// The fitted parameters: scale of thrust; d_xy, d_z; scales of inertia; offset of the centre of
/// mass; roll and pitch of the trim; damping per axis; flapping moment; wind north and east. Yaw
/// torque is not separate: the inertia about z accounts for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters(pub [f64; PARAMETERS]);

impl Parameters {
    /// The vehicle file's values.
    pub(super) fn shipped(vehicle: &VehicleParams) -> Self {
        let effects = &vehicle.modelled_effects;
        let mut p = [0.0; PARAMETERS];
        p[0] = effects.get::<ThrustScale>().map_or(1.0, |e| e.scale);
        let linear = vehicle.linear_drag_n_per_m_s.map(|d| [d, d]);
        let drag = effects.get::<RotorDrag>().map(|e| [e.d_xy, e.d_z]);
        [p[1], p[2]] = linear.or(drag).unwrap_or_default();
        [p[3], p[4], p[5]] = effects.get::<Inertia>().map_or([1.0; 3], |e| e.scale);
        if let Some(offset) = effects.get::<ComOffset>() {
            [p[6], p[7]] = [offset.x_m, offset.y_m];
        }
        if let Some(AttitudeTrim { trim }) = effects.get() {
            [p[8], p[9]] = [trim.roll, trim.pitch];
        }
        p[13] = effects.get::<BladeFlapping>().map_or(0.0, |e| e.moment_nms_m);
        if let Some(Wind { velocity }) = effects.get() {
            [p[14], p[15]] = [velocity.north(), velocity.east()];
        }
        Self(p)
    }

    /// The parameters of fitted physics.
    pub(super) fn fitted(physics: &PhysicsParameters, vehicle: &VehicleParams) -> Self {
        let mut with = vehicle.clone();
        with.linear_drag_n_per_m_s = None;
        with.modelled_effects = vehicle.modelled_effects.overlay(&physics.effects);
        let mut numbers = Self::shipped(&with);
        numbers.0[10..13].copy_from_slice(&physics.angular_damping_nms);
        numbers
    }

    /// The prior's standard deviations.
    pub(super) fn prior(vehicle: &VehicleParams) -> [f64; PARAMETERS] {
        let arm = vehicle.arm_m();
        let drag = vehicle.mass;
        let [x, y, z] = vehicle.inertia.map(|i| 5.0 * i);
        let offset = 0.2 * arm;
        // One standard deviation has the moment of a drag of one mass per second at a fifth of an
        // arm.
        let flapping = offset * drag;
        let wind = WIND_PRIOR_M_S;
        [0.3, drag, drag, 0.5, 0.5, 0.5, offset, offset, 0.05, 0.05, x, y, z, flapping, wind, wind]
    }

    /// Clamps the parameters to physical values.
    pub(super) fn bound(&mut self, vehicle: &VehicleParams) {
        let p = &mut self.0;
        p[0] = p[0].clamp(0.3, 3.0);
        for drag in &mut p[1..3] {
            *drag = drag.clamp(0.0, 5.0 * vehicle.mass);
        }
        for scale in &mut p[3..6] {
            *scale = scale.clamp(0.2, 20.0);
        }
        for trim in &mut p[8..10] {
            *trim = trim.clamp(-0.3, 0.3);
        }
        for wind in &mut p[WIND] {
            *wind = wind.clamp(-WIND_MAX_M_S, WIND_MAX_M_S);
        }
        for (damping, shipped) in
            p[10..13].iter_mut().zip(vehicle.angular_damping_nms.unwrap_or_default())
        {
            *damping = damping.max(-shipped);
        }
    }

    pub(super) fn physics(&self, vehicle: &VehicleParams) -> PhysicsParameters {
        let [scale, d_xy, d_z, ix, iy, iz, x, y, roll, pitch, kx, ky, kz, flapping, north, east] =
            self.0;
        let shipped = vehicle.modelled_effects.get::<BladeFlapping>();
        let flap_tilt = shipped.map_or(0.0, |e| e.tilt_rad_s_m);
        let trim = vehicle.modelled_effects.get::<AttitudeTrim>();
        let yaw = trim.map_or(0.0, |AttitudeTrim { trim }| trim.yaw);
        let wind = vehicle.modelled_effects.get::<Wind>();
        let down = wind.map_or(0.0, |Wind { velocity }| velocity.down());
        let mut effects = EffectSet::new();
        for (id, numbers) in [
            (ThrustScale::ID, [scale, 0.0, 0.0]),
            (RotorDrag::ID, [d_xy, d_z, 0.0]),
            (Inertia::ID, [ix, iy, iz]),
            (ComOffset::ID, [x, y, 0.0]),
            (BladeFlapping::ID, [flapping, flap_tilt, 0.0]),
            (AttitudeTrim::ID, [roll, pitch, yaw]),
            (Wind::ID, [north, east, down]),
        ] {
            let mut slots = Slots::default();
            slots[..3].copy_from_slice(&numbers);
            // A value outside the catalogue's range leaves the vehicle file's effect in force.
            let _ = effects.insert(id, slots);
        }
        PhysicsParameters { effects, angular_damping_nms: [kx, ky, kz] }
    }
}

#[cfg(test)]
mod tests {
    use vehicle::frame::{Euler, Frd, Ned};

    use super::*;
    use crate::model::Point;

    /// Rows of a vehicle with these effects that moves and turns in every direction.
    fn rows(vehicle: &VehicleParams, effects: &[&str]) -> Vec<Row> {
        let mut physics = PhysicsParameters::default();
        for effect in effects {
            physics.effects.insert_argument(effect).expect("an effect");
        }
        let model = PhysicsModel::new(vehicle, &physics).expect("physics");
        let hover_n = vehicle.mass * vehicle.gravity;
        let row = |k: u32| {
            let t = 0.05 * f64::from(k);
            let wave = |hz: f64| (std::f64::consts::TAU * hz * t).sin();
            let point = Point {
                velocity: Ned::new(1.2 * wave(0.21), wave(0.33), 0.4 * wave(0.17)),
                body_rate: Frd::new(wave(0.9), wave(0.7), 0.3 * wave(0.5)),
                attitude: Euler::new(0.2 * wave(0.41), 0.2 * wave(0.37), 3.0 * wave(0.07)),
                input: [hover_n * (1.0 + 0.1 * wave(0.27)), 0.0, 0.0, 0.0],
            };
            Row { time: t, point, label: model.accelerations(&point), truth: None }
        };
        (0..800).map(row).collect()
    }

    fn fitted(effects: &[&str]) -> (RotorDrag, Wind) {
        let text = include_str!("../../config/vehicles/crazyflie.toml");
        let vehicle = VehicleParams::from_toml_str(text).expect("a vehicle");
        let rows = rows(&vehicle, effects);
        let physics = fit(&rows.iter().collect::<Vec<_>>(), &vehicle).expect("a fit");
        (physics.effects.get().expect("a drag"), physics.effects.get().expect("a wind"))
    }

    #[test]
    fn wind_is_told_from_drag() {
        let (drag, wind) =
            fitted(&["rotor_drag:d_xy=0.012,d_z=0.006", "wind:north_m_s=2,east_m_s=-1.5"]);
        assert!((drag.d_xy / 0.012 - 1.0).abs() < 0.02, "{drag:?}");
        let error = wind.velocity - Ned::new(2.0, -1.5, 0.0);
        assert!(error.norm() < 0.05, "{wind:?}");
    }

    #[test]
    fn still_air_has_no_wind() {
        let (drag, wind) = fitted(&["rotor_drag:d_xy=0.012,d_z=0.006"]);
        assert!((drag.d_xy / 0.012 - 1.0).abs() < 0.02 && wind.velocity.norm() < 0.02, "{wind:?}");
        let (drag, wind) = fitted(&[]);
        let force_n = drag.d_xy * wind.velocity.norm();
        assert!(drag.d_xy < 2e-4 && force_n < 2e-4, "{drag:?} {wind:?}");
    }
}
