//! Turns records into messages, for the file and for live views.

use std::io;
use std::time::Duration;

use foxglove::Encode;
use foxglove::messages::{FrameTransform, Log, PoseInFrame, SceneUpdate};
use message::clock::HostTime;
use message::setpoint::State;
use prost::Message;
use vehicle::frame::Frd;

use super::record::{Direction, FrameRecord, Record, Tick};
use super::schema::{self, *};
use super::viewer::{self, ViewerPose};

/// Topics of a flight log, in the order of their channels in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The table in `log` describes them.
pub enum Topic {
    Rx,
    Tx,
    State,
    Reference,
    Setpoint,
    Control,
    Imu,
    Actuators,
    Battery,
    LinkStats,
    Timesync,
    Truth,
    Tf,
    VehiclePose,
    ReferencePose,
    Scene,
    Log,
}

/// Definition of a topic with protobuf messages.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Name of the topic.
    pub topic: &'static str,
    /// Full name of the message type.
    pub schema: &'static str,
    /// Serialised `FileDescriptorSet` of the message type.
    pub descriptor: Vec<u8>,
}

impl Topic {
    /// Every topic, in order.
    pub const ALL: [Self; 17] = [
        Self::Rx,
        Self::Tx,
        Self::State,
        Self::Reference,
        Self::Setpoint,
        Self::Control,
        Self::Imu,
        Self::Actuators,
        Self::Battery,
        Self::LinkStats,
        Self::Timesync,
        Self::Truth,
        Self::Tf,
        Self::VehiclePose,
        Self::ReferencePose,
        Self::Scene,
        Self::Log,
    ];

    /// The topic's name and message type.
    pub fn definition(self) -> Definition {
        fn own<M: Flat>(topic: &'static str) -> Definition {
            Definition { topic, schema: M::NAME, descriptor: schema::descriptor::<M>() }
        }
        macro_rules! foxglove {
            ($topic:literal, $message:ty) => {
                Definition {
                    topic: $topic,
                    schema: concat!("foxglove.", stringify!($message)),
                    descriptor: <$message>::get_schema()
                        .map(|schema| schema.data.to_vec())
                        .unwrap_or_default(),
                }
            };
        }
        match self {
            Self::Rx => own::<MavlinkFrameMessage>("/mavlink/rx"),
            Self::Tx => own::<MavlinkFrameMessage>("/mavlink/tx"),
            Self::State => own::<StateMessage>("/state"),
            Self::Reference => own::<ReferenceMessage>("/reference"),
            Self::Setpoint => own::<SetpointMessage>("/setpoint"),
            Self::Control => own::<ControlMessage>("/control"),
            Self::Imu => own::<ImuMessage>("/imu"),
            Self::Actuators => own::<ActuatorsMessage>("/actuators"),
            Self::Battery => own::<BatteryMessage>("/battery"),
            Self::LinkStats => own::<LinkStatsMessage>("/link/stats"),
            Self::Timesync => own::<TimesyncMessage>("/timesync"),
            Self::Truth => own::<TruthMessage>("/sim/truth"),
            Self::Tf => foxglove!("/tf", FrameTransform),
            Self::VehiclePose => foxglove!("/vehicle/pose", PoseInFrame),
            Self::ReferencePose => foxglove!("/reference/pose", PoseInFrame),
            Self::Scene => foxglove!("/scene", SceneUpdate),
            Self::Log => foxglove!("/log", Log),
        }
    }
}

/// Log time and publish time of a message.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// Host time of the record.
    pub log: HostTime,
    /// Vehicle time of the sample, mapped to the host clock.
    pub publish: HostTime,
}

impl Times {
    /// Times of a record that is not a sample from the vehicle.
    pub fn host(time: HostTime) -> Self {
        Self { log: time, publish: time }
    }
}

/// A destination of messages.
pub trait MessageSink {
    /// Accepts one message of `topic`.
    ///
    /// # Errors
    /// The message cannot be written.
    fn put(&mut self, topic: Topic, times: Times, message: &impl Message) -> io::Result<()>;
}

/// Shortest period of messages on 3D topics: smooth to the eye, at half the size.
const VIEWER_PERIOD: Duration = Duration::from_millis(18);

/// Turns the records of one run into messages. A message's content depends on the records only.
#[derive(Debug)]
pub struct Encoder {
    rotors: Vec<Frd>,
    is_scene_due: bool,
    viewer_next: HostTime,
    // Buffers reused from record to record.
    frame: MavlinkFrameMessage,
    control: ControlMessage,
    transforms: [FrameTransform; 2],
    pose: PoseInFrame,
}

impl Encoder {
    /// Creates an encoder for a vehicle with rotors at these positions in body axes, m. Without
    /// rotors, no shape is drawn.
    pub fn new(rotors: &[Frd]) -> Self {
        let transform = |child: &str| FrameTransform {
            parent_frame_id: viewer::MAP.into(),
            child_frame_id: child.into(),
            ..Default::default()
        };
        Self {
            rotors: rotors.to_vec(),
            is_scene_due: true,
            viewer_next: HostTime::default(),
            frame: MavlinkFrameMessage::default(),
            control: ControlMessage::default(),
            transforms: [transform(viewer::BASE_LINK), transform(viewer::BASE_LINK_REF)],
            pose: PoseInFrame { frame_id: viewer::MAP.into(), ..Default::default() },
        }
    }

    /// Emits the vehicle's shape again with the next pose, for a viewer that joined late.
    pub fn repeat_scene(&mut self) {
        self.is_scene_due = true;
    }

    /// Passes the messages of `record` to `out`. Facts and flight marks have none.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn encode(&mut self, record: &Record, out: &mut impl MessageSink) -> io::Result<()> {
        match record {
            Record::Frame(frame) => self.encode_frame(frame, out),
            Record::Tick(tick) => self.encode_tick(tick, out),
            Record::Imu { stamp, specific_force, body_rate } => {
                let times = Times { log: stamp.host, publish: stamp.sampled };
                let message = ImuMessage::new(*stamp, *specific_force, *body_rate);
                out.put(Topic::Imu, times, &message)
            }
            Record::Motors { stamp, outputs } => {
                let times = Times { log: stamp.host, publish: stamp.sampled };
                out.put(Topic::Actuators, times, &ActuatorsMessage::new(*stamp, *outputs))
            }
            Record::Battery { stamp, voltage, current, remaining } => {
                let times = Times { log: stamp.host, publish: stamp.sampled };
                let message = BatteryMessage {
                    voltage_v: voltage.unwrap_or(f64::NAN),
                    current_a: current.unwrap_or(f64::NAN),
                    remaining_ratio: remaining.unwrap_or(f64::NAN),
                };
                out.put(Topic::Battery, times, &message)
            }
            Record::Link { host, stats } => {
                out.put(Topic::LinkStats, Times::host(*host), &LinkStatsMessage::from(stats))
            }
            Record::Timesync { host, sample } => {
                out.put(Topic::Timesync, Times::host(*host), &TimesyncMessage::from(sample))
            }
            Record::Event { host, severity, source, text } => {
                let message = viewer::log_message(*host, *severity, *source, text);
                out.put(Topic::Log, Times::host(*host), &message)
            }
            Record::Truth { stamp, truth } => {
                let times = Times { log: stamp.host, publish: stamp.sampled };
                out.put(Topic::Truth, times, &TruthMessage::new(stamp.vehicle_time_us(), truth))
            }
            Record::FlightBegins(_) | Record::FlightEnds | Record::Facts(_) => Ok(()),
        }
    }

    /// Emits the pose of a vehicle without a controller, as a tick would.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn encode_pose(
        &mut self,
        times: Times,
        state: &State,
        out: &mut impl MessageSink,
    ) -> io::Result<()> {
        if times.log < self.viewer_next {
            return Ok(());
        }
        self.viewer_next = times.log + VIEWER_PERIOD;
        self.encode_poses(ViewerPose::new(state.position, state.attitude), None, times, out)
    }

    fn encode_frame(&mut self, record: &FrameRecord, out: &mut impl MessageSink) -> io::Result<()> {
        self.frame.assign(record);
        let topic = match record.direction {
            Direction::Rx => Topic::Rx,
            Direction::Tx => Topic::Tx,
        };
        out.put(topic, Times::host(record.host), &self.frame)
    }

    fn encode_tick(&mut self, tick: &Tick, out: &mut impl MessageSink) -> io::Result<()> {
        let times = Times { log: tick.stamp.host, publish: tick.stamp.sampled };
        out.put(Topic::State, times, &StateMessage::new(tick.stamp, &tick.state))?;
        if let Some(reference) = &tick.reference {
            let message = ReferenceMessage::new(tick, reference);
            out.put(Topic::Reference, times, &message)?;
        }
        if let Some(setpoint) = &tick.setpoint {
            out.put(Topic::Setpoint, times, &SetpointMessage::from(setpoint))?;
        }
        self.control.assign(tick);
        out.put(Topic::Control, times, &self.control)?;
        if times.log >= self.viewer_next {
            self.viewer_next = times.log + VIEWER_PERIOD;
            let vehicle = ViewerPose::new(tick.state.position, tick.state.attitude);
            let reference = tick.reference.as_ref();
            let reference = reference.map(|r| ViewerPose::new(r.position, r.attitude.attitude()));
            self.encode_poses(vehicle, reference, times, out)?;
        }
        Ok(())
    }

    fn encode_poses(
        &mut self,
        vehicle: ViewerPose,
        reference: Option<ViewerPose>,
        times: Times,
        out: &mut impl MessageSink,
    ) -> io::Result<()> {
        if self.is_scene_due && !self.rotors.is_empty() {
            self.is_scene_due = false;
            let scene = viewer::scene(times.log, &self.rotors);
            out.put(Topic::Scene, Times::host(times.log), &scene)?;
        }
        let poses = [(Topic::VehiclePose, Some(vehicle)), (Topic::ReferencePose, reference)];
        for ((topic, pose), transform) in poses.into_iter().zip(&mut self.transforms) {
            let Some(pose) = pose else { continue };
            pose.to_transform(times.publish, transform);
            out.put(Topic::Tf, times, &*transform)?;
            pose.to_pose(times.publish, &mut self.pose);
            out.put(topic, times, &self.pose)?;
        }
        Ok(())
    }
}
