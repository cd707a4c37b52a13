//! downwash's flat protobuf messages.
//!
//! Field names and numbers are a contract with every existing log: new fields go to the end, and
//! numbers never change. Names carry units. The world frame is NED, the body frame FRD.

mod conversion;

use foxglove::prost_types::field_descriptor_proto::{Label, Type};
use foxglove::prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
};
use prost::Message;

/// One field of a flat message.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    name: &'static str,
    number: i32,
    kind: Type,
}

impl Field {
    /// The field's name, with its unit.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The field's protobuf type.
    pub fn kind(&self) -> &'static str {
        match self.kind {
            Type::Double => "double",
            Type::Uint64 => "uint64",
            Type::Uint32 => "uint32",
            Type::Bool => "bool",
            Type::Bytes => "bytes",
            _ => "string",
        }
    }
}

/// A protobuf message whose fields are all scalars.
pub trait Flat: Message + Default {
    /// Full protobuf name.
    const NAME: &'static str;
    /// Fields in the order of their numbers.
    const FIELDS: &'static [Field];
}

/// The serialised `FileDescriptorSet` of `M`, as MCAP schema records require.
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

/// Declares a message once, as the struct that prost encodes and as the fields of its descriptor.
macro_rules! flat_messages {
    ($($(#[doc = $about:literal])* $name:ident = $full:literal { $($kind:ident $field:ident = $tag:tt;)* })*) => {$(
        $(#[doc = $about])*
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
    )*

        /// Each of these messages: its name, its documentation with the topic, and its fields.
        pub const MESSAGES: &[(&str, &str, &[Field])] =
            &[$(($full, concat!($($about),*), $name::FIELDS),)*];
    };
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

    /// `/reference`: the point of the trajectory that the controller tracks, and the radius of the
    /// tube around it; 0 without a tube.
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
        double tube_radius_m = 14;
    }

    /// `/setpoint`: the setpoint as sent.
    SetpointMessage = "downwash.Setpoint" {
        double thrust_n = 1;
        double roll_rad = 2;
        double pitch_rad = 3;
        double yaw_rad = 4;
        double p_radps = 5;
        double q_radps = 6;
        double r_radps = 7;
    }

    /// `/control`: the parts of the setpoint. Errors are state minus reference; where the reference
    /// is replanned in flight, state minus the trajectory that it leads to. `saturation` has one
    /// bit for each component of the setpoint, in the setpoint's order.
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

    /// `/actuators`: motor outputs in the vehicle's unit.
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
        uint64 dropped_frames = 18;
    }

    /// `/timesync`.
    TimesyncMessage = "downwash.Timesync" {
        double rtt_s = 1;
        double measured_offset_s = 2;
        double offset_s = 3;
        bool accepted = 4;
    }

    /// `/sim/truth`: the simulator's ground truth.
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

    /// `/status`: status of the flight at 10 Hz, in the live view only. Unknown values are empty or
    /// NaN.
    StatusMessage = "downwash.Status" {
        string link = 1;
        string vehicle = 2;
        string phase = 3;
        string mode = 4;
        string armed = 5;
        double tick_rate_hz = 6;
        uint64 setpoints = 7;
        double tracking_error_m = 8;
        double trajectory_time_s = 9;
        double trajectory_length_s = 10;
        double battery_ratio = 11;
        double rtt_s = 12;
    }

    /// `/flight/attitude` of an imported log: body to world. As in all of `/flight`, `time_s` is on
    /// the flight's clock, and each stream keeps its rate.
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

    /// `/flight/setpoint`: setpoints from the ground; parts that they leave out are NaN.
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

    /// `/flight/setpoints_missing`: number of setpoints that the log lacks before the one at this
    /// time.
    SetpointsMissingSample = "downwash.SetpointsMissingSample" {
        double time_s = 1;
        uint32 missing = 2;
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

    /// `/flight/row`: times of the rows of the imported table.
    RowSample = "downwash.RowSample" {
        double time_s = 1;
    }
}

/// `/mavlink/rx` and `/mavlink/tx`: one frame, with its header fields and its bytes on the wire.
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
