//! The project's own flat protobuf messages.
//!
//! Names and numbers of fields are a contract with every log ever written: fields are added at
//! the end, never renumbered. Units are in the names. World is NED, body is FRD.

use foxglove::prost_types::field_descriptor_proto::{Label, Type};
use foxglove::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
};
use prost::Message;
use sitl::frame::{Euler, Frd};

use super::record::{FrameRecord, LinkStats, Stamp, Tick, TimesyncSample, Truth};
use crate::setpoint::{Reference, Setpoint, State};

/// One field of a flat message.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    name: &'static str,
    number: i32,
    kind: Type,
}

/// A message of scalars, with its name and fields.
pub trait Flat: Message + Default {
    /// Full protobuf name.
    const NAME: &'static str;
    /// Fields in the order of their numbers.
    const FIELDS: &'static [Field];
}

/// The serialised `FileDescriptorSet` of `M`, as MCAP's schema records hold it.
pub fn descriptor<M: Flat>() -> Vec<u8> {
    let (package, name) = M::NAME.split_once('.').unwrap_or(("", M::NAME));
    let field = |field: &Field| FieldDescriptorProto {
        name: Some(field.name.into()),
        number: Some(field.number),
        label: Some(Label::Optional as i32),
        r#type: Some(field.kind as i32),
        ..Default::default()
    };
    let message = DescriptorProto {
        name: Some(name.into()),
        field: M::FIELDS.iter().map(field).collect(),
        ..Default::default()
    };
    let file = FileDescriptorProto {
        name: Some(format!("{package}/{name}.proto")),
        package: Some(package.into()),
        message_type: vec![message],
        syntax: Some("proto3".into()),
        ..Default::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

macro_rules! rust_type {
    (double) => {
        f64
    };
    (uint64) => {
        u64
    };
    (uint32) => {
        u32
    };
    (bool) => {
        bool
    };
    (string) => {
        String
    };
}

macro_rules! proto_type {
    (double) => {
        Type::Double
    };
    (uint64) => {
        Type::Uint64
    };
    (uint32) => {
        Type::Uint32
    };
    (bool) => {
        Type::Bool
    };
    (string) => {
        Type::String
    };
}

/// Declares a message once: the struct that prost encodes, and the fields of its descriptor.
macro_rules! flat_messages {
    ($($(#[$meta:meta])* $name:ident = $full:literal { $($kind:ident $field:ident = $tag:tt;)* })*) => {$(
        $(#[$meta])*
        #[derive(Clone, PartialEq, prost::Message)]
        #[allow(missing_docs)] // The unit is in the name.
        pub struct $name {
            $(#[prost($kind, tag = $tag)] pub $field: rust_type!($kind),)*
        }

        impl Flat for $name {
            const NAME: &'static str = $full;
            const FIELDS: &'static [Field] = &[
                $(Field { name: stringify!($field), number: $tag, kind: proto_type!($kind) },)*
            ];
        }
    )*};
}

flat_messages! {
    /// `/state`: the estimate that the controller used.
    StateMessage = "downwash.State" {
        uint64 vehicle_time_us = 1;
        double p_n_m = 2;
        double p_e_m = 3;
        double p_d_m = 4;
        double v_n_mps = 5;
        double v_e_mps = 6;
        double v_d_mps = 7;
        double q_w = 8;
        double q_x = 9;
        double q_y = 10;
        double q_z = 11;
        double roll_rad = 12;
        double pitch_rad = 13;
        double yaw_rad = 14;
        double p_radps = 15;
        double q_radps = 16;
        double r_radps = 17;
    }

    /// `/reference`: the point of the trajectory that is tracked.
    ReferenceMessage = "downwash.Reference" {
        double trajectory_time_s = 1;
        double p_n_m = 2;
        double p_e_m = 3;
        double p_d_m = 4;
        double v_n_mps = 5;
        double v_e_mps = 6;
        double v_d_mps = 7;
        double roll_rad = 8;
        double pitch_rad = 9;
        double yaw_rad = 10;
        double p_radps = 11;
        double q_radps = 12;
        double r_radps = 13;
    }

    /// `/setpoint`: what was sent.
    SetpointMessage = "downwash.Setpoint" {
        double thrust_n = 1;
        double roll_rad = 2;
        double pitch_rad = 3;
        double yaw_rad = 4;
        double p_radps = 5;
        double q_radps = 6;
        double r_radps = 7;
    }

    /// `/control`: how the setpoint came about. Errors are state minus reference; `saturation` has
    /// one bit for each component of the setpoint, in the setpoint's order.
    ControlMessage = "downwash.Control" {
        string phase = 1;
        double trajectory_time_s = 2;
        double sample_age_s = 3;
        uint32 saturation = 4;
        double error_n_m = 5;
        double error_e_m = 6;
        double error_d_m = 7;
        double error_3d_m = 8;
        double error_yaw_rad = 9;
        double ff_thrust_n = 10;
        double ff_roll_rad = 11;
        double ff_pitch_rad = 12;
        double ff_yaw_rad = 13;
        double ff_p_radps = 14;
        double ff_q_radps = 15;
        double ff_r_radps = 16;
        double fb_thrust_n = 17;
        double fb_roll_rad = 18;
        double fb_pitch_rad = 19;
        double fb_yaw_rad = 20;
        double fb_p_radps = 21;
        double fb_q_radps = 22;
        double fb_r_radps = 23;
    }

    /// `/imu`: specific force and body rate in FRD.
    ImuMessage = "downwash.Imu" {
        uint64 vehicle_time_us = 1;
        double f_x_mps2 = 2;
        double f_y_mps2 = 3;
        double f_z_mps2 = 4;
        double p_radps = 5;
        double q_radps = 6;
        double r_radps = 7;
    }

    /// `/actuators`: motor outputs in the vehicle's own unit.
    ActuatorsMessage = "downwash.Actuators" {
        uint64 vehicle_time_us = 1;
        double output_1 = 2;
        double output_2 = 3;
        double output_3 = 4;
        double output_4 = 5;
    }

    /// `/battery`.
    BatteryMessage = "downwash.Battery" {
        double voltage_v = 1;
        double current_a = 2;
        double remaining_ratio = 3;
    }

    /// `/link/stats`.
    LinkStatsMessage = "downwash.LinkStats" {
        double rx_frames_hz = 1;
        double rx_bytes_per_s = 2;
        double tx_frames_hz = 3;
        double tx_bytes_per_s = 4;
        double attitude_hz = 5;
        double position_hz = 6;
        double odometry_hz = 7;
        uint64 crc_errors = 8;
        uint64 lost_frames = 9;
        uint64 unknown_frames = 10;
        uint64 unframed_bytes = 11;
        uint64 reconnects = 12;
        double rtt_s = 13;
        double clock_offset_s = 14;
        uint64 foreign_frames = 15;
        uint64 stray_frames = 16;
        uint64 refused_frames = 17;
    }

    /// `/timesync`.
    TimesyncMessage = "downwash.Timesync" {
        double rtt_s = 1;
        double measured_offset_s = 2;
        double offset_s = 3;
        bool accepted = 4;
    }

    /// `/sim/truth`: what the simulator knows and no sensor says.
    TruthMessage = "downwash.Truth" {
        uint64 vehicle_time_us = 1;
        double p_n_m = 2;
        double p_e_m = 3;
        double p_d_m = 4;
        double v_n_mps = 5;
        double v_e_mps = 6;
        double v_d_mps = 7;
        double q_w = 8;
        double q_x = 9;
        double q_y = 10;
        double q_z = 11;
        double p_radps = 12;
        double q_radps = 13;
        double r_radps = 14;
        double a_n_mps2 = 15;
        double a_e_mps2 = 16;
        double a_d_mps2 = 17;
        double alpha_x_radps2 = 18;
        double alpha_y_radps2 = 19;
        double alpha_z_radps2 = 20;
        double rotor_1_n = 21;
        double rotor_2_n = 22;
        double rotor_3_n = 23;
        double rotor_4_n = 24;
    }

    /// `/flight/attitude` of an imported log: body to world. As in all of `/flight`, `time_s` is
    /// the flight's own clock, and each stream keeps its rate.
    AttitudeSample = "downwash.AttitudeSample" {
        double time_s = 1;
        double q_w = 2;
        double q_x = 3;
        double q_y = 4;
        double q_z = 5;
    }

    /// `/flight/position`.
    PositionSample = "downwash.PositionSample" {
        double time_s = 1;
        double p_n_m = 2;
        double p_e_m = 3;
        double p_d_m = 4;
    }

    /// `/flight/velocity`.
    VelocitySample = "downwash.VelocitySample" {
        double time_s = 1;
        double v_n_mps = 2;
        double v_e_mps = 3;
        double v_d_mps = 4;
    }

    /// `/flight/body_rate`.
    BodyRateSample = "downwash.BodyRateSample" {
        double time_s = 1;
        double p_radps = 2;
        double q_radps = 3;
        double r_radps = 4;
    }

    /// `/flight/specific_force`.
    SpecificForceSample = "downwash.SpecificForceSample" {
        double time_s = 1;
        double f_x_mps2 = 2;
        double f_y_mps2 = 3;
        double f_z_mps2 = 4;
    }

    /// `/flight/outputs`: motor outputs, in the unit that the metadata names.
    OutputsSample = "downwash.OutputsSample" {
        double time_s = 1;
        double output_1 = 2;
        double output_2 = 3;
        double output_3 = 4;
        double output_4 = 5;
    }

    /// `/flight/rotor_speed`.
    RotorSpeedSample = "downwash.RotorSpeedSample" {
        double time_s = 1;
        double rotor_1_radps = 2;
        double rotor_2_radps = 3;
        double rotor_3_radps = 4;
        double rotor_4_radps = 5;
    }

    /// `/flight/setpoint`: what the ground asked for; parts that it did not ask for are NaN.
    AttitudeSetpointSample = "downwash.AttitudeSetpointSample" {
        double time_s = 1;
        double q_w = 2;
        double q_x = 3;
        double q_y = 4;
        double q_z = 5;
        double p_radps = 6;
        double q_radps = 7;
        double r_radps = 8;
        double thrust_ratio = 9;
    }

    /// `/flight/voltage`.
    VoltageSample = "downwash.VoltageSample" {
        double time_s = 1;
        double voltage_v = 2;
    }

    /// `/flight/in_air`.
    InAirSample = "downwash.InAirSample" {
        double time_s = 1;
        bool in_air = 2;
    }

    /// `/flight/row`: times of the rows of the table that the flight was.
    RowSample = "downwash.RowSample" {
        double time_s = 1;
    }
}

/// `/mavlink/rx` and `/mavlink/tx`: one frame, header's fields and the bytes on the wire.
#[derive(Clone, PartialEq, prost::Message)]
#[allow(missing_docs)]
pub struct MavlinkFrameMessage {
    #[prost(uint32, tag = 1)]
    pub message_id: u32,
    #[prost(uint32, tag = 2)]
    pub system_id: u32,
    #[prost(uint32, tag = 3)]
    pub component_id: u32,
    #[prost(uint32, tag = 4)]
    pub sequence: u32,
    #[prost(bytes = "vec", tag = 5)]
    pub frame: Vec<u8>,
}

impl Flat for MavlinkFrameMessage {
    const NAME: &'static str = "downwash.MavlinkFrame";
    const FIELDS: &'static [Field] = &[
        Field { name: "message_id", number: 1, kind: Type::Uint32 },
        Field { name: "system_id", number: 2, kind: Type::Uint32 },
        Field { name: "component_id", number: 3, kind: Type::Uint32 },
        Field { name: "sequence", number: 4, kind: Type::Uint32 },
        Field { name: "frame", number: 5, kind: Type::Bytes },
    ];
}

/// Microseconds of the vehicle's clock, 0 where the vehicle did not stamp the sample.
fn vehicle_time_us(stamp: Stamp) -> u64 {
    stamp.vehicle.map_or(0, |t| t.as_us())
}

impl MavlinkFrameMessage {
    /// Takes over `record`, keeping the buffer.
    pub(super) fn assign(&mut self, record: &FrameRecord) {
        self.message_id = record.message_id;
        self.system_id = record.system;
        self.component_id = record.component.into();
        self.sequence = record.sequence.into();
        self.frame.clear();
        self.frame.extend_from_slice(record.bytes());
    }
}

impl StateMessage {
    pub(super) fn new(stamp: Stamp, state: &State) -> Self {
        let [p_n_m, p_e_m, p_d_m] = state.position.to_array();
        let [v_n_mps, v_e_mps, v_d_mps] = state.velocity.to_array();
        let [p_radps, q_radps, r_radps] = state.body_rate.to_array();
        let q = state.attitude.canonical();
        let Euler { roll, pitch, yaw } = q.euler();
        Self {
            vehicle_time_us: vehicle_time_us(stamp),
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
    pub(super) fn new(trajectory_time: Option<f64>, reference: &Reference) -> Self {
        let [p_n_m, p_e_m, p_d_m] = reference.position.to_array();
        let [v_n_mps, v_e_mps, v_d_mps] = reference.velocity.to_array();
        let [p_radps, q_radps, r_radps] = reference.body_rate.to_array();
        let Euler { roll, pitch, yaw } = reference.attitude;
        Self {
            trajectory_time_s: trajectory_time.unwrap_or(f64::NAN),
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

/// A setpoint of which nothing is known.
const UNKNOWN: Setpoint = Setpoint {
    thrust_n: f64::NAN,
    attitude: Euler::new(f64::NAN, f64::NAN, f64::NAN),
    body_rate: Frd::new(f64::NAN, f64::NAN, f64::NAN),
};

impl ControlMessage {
    /// Takes over `tick`, keeping the buffer of the phase's name.
    pub(super) fn assign(&mut self, tick: &Tick) {
        let mut phase = std::mem::take(&mut self.phase);
        phase.clear();
        phase.push_str(tick.phase);
        let ([error_n_m, error_e_m, error_d_m], error_3d_m, error_yaw_rad) = match &tick.reference {
            Some(reference) => {
                let error = tick.state.position - reference.position;
                let yaw = tick.state.attitude.euler().yaw - reference.attitude.yaw;
                (error.to_array(), error.norm(), sitl::frame::wrap_angle(yaw))
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
    pub(super) fn new(stamp: Stamp, specific_force: Frd, body_rate: Frd) -> Self {
        let [f_x_mps2, f_y_mps2, f_z_mps2] = specific_force.to_array();
        let [p_radps, q_radps, r_radps] = body_rate.to_array();
        let vehicle_time_us = vehicle_time_us(stamp);
        Self { vehicle_time_us, f_x_mps2, f_y_mps2, f_z_mps2, p_radps, q_radps, r_radps }
    }
}

impl ActuatorsMessage {
    pub(super) fn new(stamp: Stamp, outputs: [f32; 4]) -> Self {
        let [output_1, output_2, output_3, output_4] = outputs.map(f64::from);
        Self { vehicle_time_us: vehicle_time_us(stamp), output_1, output_2, output_3, output_4 }
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
    pub(super) fn new(stamp: Stamp, truth: &Truth) -> Self {
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
            vehicle_time_us: vehicle_time_us(stamp),
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
