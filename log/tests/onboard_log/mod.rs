//! Builds PX4 and ArduPilot onboard logs row by row.

/// A ULog under construction.
pub struct Ulog {
    pub bytes: Vec<u8>,
    topics: u16,
}

impl Ulog {
    pub fn new() -> Self {
        let mut bytes = b"ULog\x01\x12\x35\x01".to_vec();
        bytes.extend(0_u64.to_le_bytes());
        let mut log = Self { bytes, topics: 0 };
        log.message(b'B', &[0; 40]);
        log
    }

    pub fn message(&mut self, kind: u8, body: &[u8]) {
        self.bytes.extend((body.len() as u16).to_le_bytes());
        self.bytes.push(kind);
        self.bytes.extend(body);
    }

    pub fn format(&mut self, text: &str) {
        self.message(b'F', text.as_bytes());
    }

    pub fn info(&mut self, key: &str, value: &[u8]) {
        self.message(b'I', &[&[key.len() as u8], key.as_bytes(), value].concat());
    }

    pub fn parameter(&mut self, name: &str, value: f32) {
        let key = format!("float {name}");
        self.message(b'P', &[&[key.len() as u8], key.as_bytes(), &value.to_le_bytes()].concat());
    }

    pub fn whole_parameter(&mut self, name: &str, value: i32) {
        let key = format!("int32_t {name}");
        self.message(b'P', &[&[key.len() as u8], key.as_bytes(), &value.to_le_bytes()].concat());
    }

    /// Announces a topic and returns the number that its rows carry.
    pub fn subscribe(&mut self, topic: &str, instance: u8) -> u16 {
        let number = self.topics;
        self.topics += 1;
        self.message(b'A', &[&[instance], &number.to_le_bytes()[..], topic.as_bytes()].concat());
        number
    }

    /// A row of a topic: its stamp in us, then the bytes behind it.
    pub fn row(&mut self, number: u16, time_us: u64, rest: &[u8]) {
        self.message(b'D', &[&number.to_le_bytes()[..], &time_us.to_le_bytes(), rest].concat());
    }

    pub fn sync(&mut self) {
        self.message(b'S', &[0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12]);
    }
}

pub fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A short flight as PX4 logs it, with a turning attitude and every topic that the importer reads.
pub fn ulog(seconds: f64) -> Ulog {
    let mut log = Ulog::new();
    log.info("char[3] sys_name", b"PX4");
    log.format("vehicle_attitude:uint64_t timestamp;uint64_t timestamp_sample;float[4] q;uint8_t n;uint8_t[7] _padding0;");
    log.format("sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;");
    log.format("vehicle_local_position:uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;");
    log.format("actuator_motors:uint64_t timestamp;float[12] control;");
    log.format("battery_status:uint64_t timestamp;float voltage_v;bool connected;");
    log.format("vehicle_land_detected:uint64_t timestamp;bool landed;bool maybe_landed;bool ground_contact;");
    log.format("esc_report:uint64_t timestamp;float esc_rpm;uint8_t actuator_function;uint8_t[3] _padding0;");
    log.format(
        "esc_status:uint64_t timestamp;uint8_t esc_count;uint8_t[7] _padding0;esc_report[4] esc;",
    );
    log.whole_parameter("CA_ROTOR_COUNT", 4);
    let attitude = log.subscribe("vehicle_attitude", 0);
    let sensors = log.subscribe("sensor_combined", 0);
    let position = log.subscribe("vehicle_local_position", 0);
    let motors = log.subscribe("actuator_motors", 0);
    let battery = log.subscribe("battery_status", 0);
    let second = log.subscribe("battery_status", 1);
    let land = log.subscribe("vehicle_land_detected", 0);
    let esc = log.subscribe("esc_status", 0);
    for step in 0..(seconds * 250.0) as u64 {
        let us = 1_000_000 + 4000 * step;
        let t = 0.004 * step as f64;
        // Rolls to and fro by 0.3 rad at 1 rad/s.
        let (roll, rate) = (0.3 * t.sin(), 0.3 * t.cos());
        let (s, c) = (0.5 * roll).sin_cos();
        let imu = [
            floats(&[rate as f32, 0.0, 0.0]),
            4000_u32.to_le_bytes().to_vec(),
            500_i32.to_le_bytes().to_vec(),
            floats(&[0.1, -0.2, -9.81]),
            4000_u32.to_le_bytes().to_vec(),
        ];
        log.row(sensors, us, &imu.concat());
        if step % 2 == 0 {
            let q = floats(&[c as f32, s as f32, 0.0, 0.0]);
            // The padding at the end of a row is not written.
            log.row(attitude, us + 300, &[&us.to_le_bytes()[..], &q, &[0]].concat());
            let mut controls = [f32::NAN; 12];
            controls[..4].copy_from_slice(&[0.4, 0.5, 0.6, 0.7]);
            log.row(motors, us, &floats(&controls));
        }
        if step % 10 == 0 {
            let state = floats(&[1.0, 2.0, -3.0, 0.1, 0.2, -0.3]);
            log.row(position, us, &[&state[..], &[1, 1, 1, u8::from(step > 100)]].concat());
        }
        if step % 50 == 0 {
            log.row(battery, us, &[&floats(&[15.5])[..], &[1]].concat());
            log.row(second, us, &[&floats(&[5.0])[..], &[1]].concat());
            log.row(land, us, &[u8::from(step < 100), 0, 0]);
            let report = |rpm: f32, function: u8| {
                [&us.to_le_bytes()[..], &floats(&[rpm]), &[function, 0, 0, 0]].concat()
            };
            // The motor controllers are wired in a different order from the motors.
            let reports =
                [report(100.0, 102), report(-200.0, 101), report(300.0, 103), report(400.0, 104)];
            log.row(esc, us, &[&[4, 0, 0, 0, 0, 0, 0, 0][..], &reports.concat()].concat());
            log.sync();
        }
    }
    log
}

/// A DataFlash log under construction.
pub struct DataFlash {
    pub bytes: Vec<u8>,
}

impl DataFlash {
    pub fn new() -> Self {
        let mut log = Self { bytes: Vec::new() };
        log.define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
        log
    }

    pub fn define(&mut self, kind: u8, name: &str, format: &str, columns: &str) {
        let size = |format: u8| match format {
            b'b' | b'B' | b'M' => 1,
            b'h' | b'H' | b'c' | b'C' => 2,
            b'q' | b'Q' | b'd' => 8,
            b'N' => 16,
            b'Z' => 64,
            _ => 4,
        };
        let length = 3 + format.bytes().map(size).sum::<u8>();
        let fill = |text: &str, size: usize| {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(size, 0);
            bytes
        };
        let body =
            [vec![kind, length], fill(name, 4), fill(format, 16), fill(columns, 64)].concat();
        self.message(128, &body);
    }

    pub fn message(&mut self, kind: u8, body: &[u8]) {
        self.bytes.extend([0xA3, 0x95, kind]);
        self.bytes.extend(body);
    }

    pub fn parameter(&mut self, name: &str, value: f32) {
        let mut text = name.as_bytes().to_vec();
        text.resize(16, 0);
        self.message(2, &[&0_u64.to_le_bytes()[..], &text, &value.to_le_bytes()].concat());
    }

    pub fn text(&mut self, text: &str) {
        let mut bytes = text.as_bytes().to_vec();
        bytes.resize(64, 0);
        self.message(3, &[&0_u64.to_le_bytes()[..], &bytes].concat());
    }
}

/// A short flight as ArduCopter logs it.
pub fn dataflash(seconds: f64) -> DataFlash {
    let mut log = DataFlash::new();
    log.define(2, "PARM", "QNf", "TimeUS,Name,Value");
    log.define(3, "MSG", "QZ", "TimeUS,Message");
    log.define(10, "ATT", "Qccccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF");
    log.define(11, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ");
    log.define(12, "XKF1", "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD");
    log.define(13, "RCOU", "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8");
    log.define(14, "BAT", "QBf", "TimeUS,Inst,Volt");
    log.define(15, "EV", "QB", "TimeUS,Id");
    log.define(16, "ESC", "QBf", "TimeUS,Instance,RPM");
    for (name, value) in [
        ("MOT_PWM_MIN", 1000.0),
        ("MOT_PWM_MAX", 2000.0),
        ("MOT_SPIN_MIN", 0.15),
        ("MOT_SPIN_MAX", 0.95),
        ("FRAME_CLASS", 1.0),
        ("FRAME_TYPE", 1.0),
        ("SERVO1_FUNCTION", 36.0),
        ("SERVO2_FUNCTION", 35.0),
        ("SERVO3_FUNCTION", 34.0),
        ("SERVO4_FUNCTION", 33.0),
    ] {
        log.parameter(name, value);
    }
    log.text("ArduCopter V4.5.0 (abc)");
    log.text("Frame: QUAD/X");
    for step in 0..(seconds * 100.0) as u64 {
        let us = 5_000_000 + 10_000 * step;
        let t = 0.01 * step as f64;
        let (roll, rate) = (0.3 * t.sin(), 0.3 * t.cos());
        let stamp = us.to_le_bytes();
        for core in [0_u8, 1] {
            let force = [rate as f32, 0.0, 0.0, 0.1, -0.2, -9.81];
            log.message(11, &[&stamp[..], &[core], &floats(&force)].concat());
        }
        if step % 2 == 0 {
            let centidegrees = (roll.to_degrees() * 100.0).round() as i16;
            let fields = [0, centidegrees, 0, 0, 0, 0, 0];
            let fields: Vec<u8> = fields.iter().flat_map(|c| c.to_le_bytes()).collect();
            log.message(10, &[&stamp[..], &fields].concat());
            let state = floats(&[0.1, 0.2, -0.3, 1.0, 2.0, -3.0]);
            log.message(12, &[&stamp[..], &[0], &state].concat());
        }
        if step % 10 == 0 {
            let pulses = [1950_u16, 1750, 1550, 1350, 0, 0, 0, 0];
            let pulses: Vec<u8> = pulses.iter().flat_map(|p| p.to_le_bytes()).collect();
            log.message(13, &[&stamp[..], &pulses].concat());
            log.message(14, &[&stamp[..], &[0], &floats(&[12.1])].concat());
            for instance in 0..4_u8 {
                let rpm = floats(&[1000.0 * f32::from(instance + 1)]);
                log.message(16, &[&stamp[..], &[instance], &rpm].concat());
            }
        }
        if step == 50 {
            log.message(15, &[&stamp[..], &[28]].concat());
        }
    }
    log
}

/// A flight as ArduCopter logged it from 2014 to 2016: stamps in ms, no units, no functions of
/// outputs, voltage in hundredths, the first EKF.
pub fn old_dataflash(seconds: f64) -> DataFlash {
    let mut log = DataFlash::new();
    log.define(2, "PARM", "INf", "TimeMS,Name,Value");
    log.define(3, "MSG", "Z", "Message");
    log.define(10, "ATT", "IccccCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw");
    log.define(11, "IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ");
    log.define(12, "EKF1", "Icccffffff", "TimeMS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD");
    log.define(13, "RCOU", "Ihhhh", "TimeMS,Chan1,Chan2,Chan3,Chan4");
    log.define(14, "CURR", "Ihh", "TimeMS,ThrOut,Volt");
    for (name, value) in
        [("RC3_MIN", 1100.0_f32), ("RC3_MAX", 1900.0), ("MOT_SPIN_MIN", 0.0), ("MOT_SPIN_MAX", 1.0)]
    {
        let mut text = name.as_bytes().to_vec();
        text.resize(16, 0);
        log.message(2, &[&0_u32.to_le_bytes()[..], &text, &value.to_le_bytes()].concat());
    }
    let mut text = b"ArduCopter V3.2.1 (36b405fb)".to_vec();
    text.resize(64, 0);
    log.message(3, &text);
    for step in 0..(seconds * 50.0) as u32 {
        let stamp = (10_000 + 20 * step).to_le_bytes();
        let t = 0.02 * f64::from(step);
        let (roll, rate) = (0.3 * t.sin(), 0.3 * t.cos());
        let centidegrees = ((roll.to_degrees() * 100.0).round() as i16).to_le_bytes();
        let zero = [0, 0];
        let attitude = [zero, centidegrees, zero, zero, zero, zero].concat();
        log.message(10, &[&stamp[..], &attitude].concat());
        log.message(
            11,
            &[&stamp[..], &floats(&[rate as f32, 0.0, 0.0, 0.1, -0.2, -9.81])].concat(),
        );
        let state = floats(&[0.1, 0.2, -0.3, 1.0, 2.0, -3.0]);
        log.message(12, &[&stamp[..], &[0; 6], &state].concat());
        let pulses = [1300_i16, 1500, 1700, 1900].map(i16::to_le_bytes).concat();
        log.message(13, &[&stamp[..], &pulses].concat());
        if step % 25 == 0 {
            log.message(14, &[&stamp[..], &[0, 0], &1234_i16.to_le_bytes()].concat());
        }
    }
    log
}

/// An instance of actuator_outputs: the number of outputs, and their values at a row.
pub type OutputInstance<'a> = (u32, &'a dyn Fn(usize) -> [f32; 16]);

/// A log with attitude, position and these instances of actuator_outputs.
pub fn px4_outputs(parameters: &[(&str, i32)], instances: &[OutputInstance]) -> Ulog {
    let mut log = Ulog::new();
    log.info("char[3] sys_name", b"PX4");
    log.format("vehicle_attitude:uint64_t timestamp;float[4] q;");
    log.format("vehicle_local_position:uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;");
    log.format("sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;");
    log.format("actuator_outputs:uint64_t timestamp;uint32_t noutputs;float[16] output;");
    for (name, value) in parameters {
        log.whole_parameter(name, *value);
    }
    let attitude = log.subscribe("vehicle_attitude", 0);
    let position = log.subscribe("vehicle_local_position", 0);
    let sensors = log.subscribe("sensor_combined", 0);
    let outputs: Vec<u16> = (0..instances.len())
        .map(|instance| log.subscribe("actuator_outputs", instance as u8))
        .collect();
    for step in 0..400_usize {
        let us = 1_000_000 + 20_000 * step as u64;
        let t = 0.02 * step as f32;
        let (s, c) = (0.15 * t.sin()).sin_cos();
        log.row(attitude, us, &floats(&[c, s, 0.0, 0.0]));
        log.row(sensors, us, &floats(&[0.3 * t.cos(), 0.0, 0.0, 0.0, 0.0, -9.81]));
        log.row(position, us, &floats(&[t.sin(), 0.0, -2.0, t.cos(), 0.0, 0.0]));
        for (number, (count, values)) in outputs.iter().zip(instances) {
            log.row(*number, us, &[&count.to_le_bytes()[..], &floats(&values(step))].concat());
        }
    }
    log
}
