//! Conversions from records to messages.

use message::setpoint::{Reference, Setpoint, State};
use vehicle::frame::{Euler, Frd};

use super::{
    ActuatorsMessage, ControlMessage, ImuMessage, LinkStatsMessage, MavlinkFrameMessage,
    ReferenceMessage, SetpointMessage, StateMessage, TimesyncMessage, TruthMessage,
};
use crate::record::{FrameRecord, LinkStats, Stamp, Tick, TimesyncSample, Truth};

impl MavlinkFrameMessage {
    /// Copies `record`, reusing the buffer.
    pub(crate) fn assign(&mut self, record: &FrameRecord) {
        self.message_id = record.message_id;
        self.system_id = record.system;
        self.component_id = record.component.into();
        self.sequence = record.sequence.into();
        self.frame.clear();
        self.frame.extend_from_slice(record.bytes());
    }
}

impl StateMessage {
    pub(crate) fn new(stamp: Stamp, state: &State) -> Self {
        let [p_n_m, p_e_m, p_d_m] = state.position.to_array();
        let [v_n_mps, v_e_mps, v_d_mps] = state.velocity.to_array();
        let [p_radps, q_radps, r_radps] = state.body_rate.to_array();
        let q = state.attitude.canonical();
        let Euler { roll, pitch, yaw } = q.euler();
        Self {
            vehicle_time_us: stamp.vehicle_time_us(),
            p_n_m,
            p_e_m,
            p_d_m,
            v_n_mps,
            v_e_mps,
            v_d_mps,
            q_w: q.w,
            q_x: q.x,
            q_y: q.y,
            q_z: q.z,
            roll_rad: roll,
            pitch_rad: pitch,
            yaw_rad: yaw,
            p_radps,
            q_radps,
            r_radps,
        }
    }
}

impl ReferenceMessage {
    pub(crate) fn new(tick: &Tick, reference: &Reference) -> Self {
        let [p_n_m, p_e_m, p_d_m] = reference.position.to_array();
        let [v_n_mps, v_e_mps, v_d_mps] = reference.velocity.to_array();
        let [p_radps, q_radps, r_radps] = reference.body_rate.to_array();
        let Euler { roll, pitch, yaw } = reference.attitude;
        Self {
            trajectory_time_s: tick.trajectory_time.unwrap_or(f64::NAN),
            p_n_m,
            p_e_m,
            p_d_m,
            v_n_mps,
            v_e_mps,
            v_d_mps,
            roll_rad: roll,
            pitch_rad: pitch,
            yaw_rad: yaw,
            p_radps,
            q_radps,
            r_radps,
            tube_radius_m: tick.tube_radius_m.unwrap_or_default(),
        }
    }
}

impl From<&Setpoint> for SetpointMessage {
    fn from(setpoint: &Setpoint) -> Self {
        let Euler { roll, pitch, yaw } = setpoint.attitude;
        let [p_radps, q_radps, r_radps] = setpoint.body_rate.to_array();
        Self {
            thrust_n: setpoint.thrust_n,
            roll_rad: roll,
            pitch_rad: pitch,
            yaw_rad: yaw,
            p_radps,
            q_radps,
            r_radps,
        }
    }
}

/// A setpoint whose components are all unknown.
const UNKNOWN: Setpoint = Setpoint {
    thrust_n: f64::NAN,
    attitude: Euler::new(f64::NAN, f64::NAN, f64::NAN),
    body_rate: Frd::new(f64::NAN, f64::NAN, f64::NAN),
};

impl ControlMessage {
    /// Copies `tick`, reusing the buffer of the phase's name.
    pub(crate) fn assign(&mut self, tick: &Tick) {
        let mut phase = std::mem::take(&mut self.phase);
        phase.clear();
        phase.push_str(tick.phase);
        let ([error_n_m, error_e_m, error_d_m], error_3d_m, error_yaw_rad) = match &tick.reference {
            Some(reference) => {
                let error = tick.state.position - tick.desired.unwrap_or(reference.position);
                let yaw = tick.state.attitude.euler().yaw - reference.attitude.yaw;
                (error.to_array(), error.norm(), vehicle::frame::wrap_angle(yaw))
            }
            None => ([f64::NAN; 3], f64::NAN, f64::NAN),
        };
        let ff = tick.reference.map_or(UNKNOWN, |r| r.feedforward);
        let fb = if tick.reference.is_some() { tick.feedback } else { UNKNOWN };
        let [ff_p_radps, ff_q_radps, ff_r_radps] = ff.body_rate.to_array();
        let [fb_p_radps, fb_q_radps, fb_r_radps] = fb.body_rate.to_array();
        *self = Self {
            phase,
            trajectory_time_s: tick.trajectory_time.unwrap_or(f64::NAN),
            sample_age_s: tick.sample_age,
            saturation: tick.saturation,
            error_n_m,
            error_e_m,
            error_d_m,
            error_3d_m,
            error_yaw_rad,
            ff_thrust_n: ff.thrust_n,
            ff_roll_rad: ff.attitude.roll,
            ff_pitch_rad: ff.attitude.pitch,
            ff_yaw_rad: ff.attitude.yaw,
            ff_p_radps,
            ff_q_radps,
            ff_r_radps,
            fb_thrust_n: fb.thrust_n,
            fb_roll_rad: fb.attitude.roll,
            fb_pitch_rad: fb.attitude.pitch,
            fb_yaw_rad: fb.attitude.yaw,
            fb_p_radps,
            fb_q_radps,
            fb_r_radps,
        };
    }
}

impl ImuMessage {
    pub(crate) fn new(stamp: Stamp, specific_force: Frd, body_rate: Frd) -> Self {
        let [f_x_mps2, f_y_mps2, f_z_mps2] = specific_force.to_array();
        let [p_radps, q_radps, r_radps] = body_rate.to_array();
        let vehicle_time_us = stamp.vehicle_time_us();
        Self { vehicle_time_us, f_x_mps2, f_y_mps2, f_z_mps2, p_radps, q_radps, r_radps }
    }
}

impl ActuatorsMessage {
    pub(crate) fn new(stamp: Stamp, outputs: [f32; 4]) -> Self {
        let [output_1, output_2, output_3, output_4] = outputs.map(f64::from);
        Self { vehicle_time_us: stamp.vehicle_time_us(), output_1, output_2, output_3, output_4 }
    }
}

impl From<&LinkStats> for LinkStatsMessage {
    fn from(s: &LinkStats) -> Self {
        Self {
            rx_frames_hz: s.rx_frames_hz,
            rx_bytes_per_s: s.rx_bytes_per_s,
            tx_frames_hz: s.tx_frames_hz,
            tx_bytes_per_s: s.tx_bytes_per_s,
            attitude_hz: s.attitude_hz,
            position_hz: s.position_hz,
            odometry_hz: s.odometry_hz,
            crc_errors: s.crc_errors,
            lost_frames: s.lost_frames,
            unknown_frames: s.unknown_frames,
            unframed_bytes: s.unframed_bytes,
            reconnects: s.reconnects,
            rtt_s: s.rtt_s,
            clock_offset_s: s.clock_offset_s,
            foreign_frames: s.foreign_frames,
            stray_frames: s.stray_frames,
            refused_frames: s.refused_frames,
            dropped_frames: s.dropped_frames,
        }
    }
}

impl From<&TimesyncSample> for TimesyncMessage {
    fn from(s: &TimesyncSample) -> Self {
        Self {
            rtt_s: s.rtt_s,
            measured_offset_s: s.measured_offset_s,
            offset_s: s.offset_s,
            accepted: s.accepted,
        }
    }
}

impl TruthMessage {
    pub(crate) fn new(vehicle_time_us: u64, truth: &Truth) -> Self {
        let state = &truth.state;
        let [p_n_m, p_e_m, p_d_m] = state.position.to_array();
        let [v_n_mps, v_e_mps, v_d_mps] = state.velocity.to_array();
        let [p_radps, q_radps, r_radps] = state.body_rate.to_array();
        let [a_n_mps2, a_e_mps2, a_d_mps2] = truth.acceleration.to_array();
        let [alpha_x_radps2, alpha_y_radps2, alpha_z_radps2] =
            truth.angular_acceleration.to_array();
        let [rotor_1_n, rotor_2_n, rotor_3_n, rotor_4_n] = truth.rotor_thrust;
        let q = state.attitude.canonical();
        Self {
            vehicle_time_us,
            p_n_m,
            p_e_m,
            p_d_m,
            v_n_mps,
            v_e_mps,
            v_d_mps,
            q_w: q.w,
            q_x: q.x,
            q_y: q.y,
            q_z: q.z,
            p_radps,
            q_radps,
            r_radps,
            a_n_mps2,
            a_e_mps2,
            a_d_mps2,
            alpha_x_radps2,
            alpha_y_radps2,
            alpha_z_radps2,
            rotor_1_n,
            rotor_2_n,
            rotor_3_n,
            rotor_4_n,
        }
    }
}
