//! Cost of logging: one simulated second of a flight, and one tick's records.

#[path = "../tests/log_flight/mod.rs"]
mod log_flight;

use std::path::Path;
use std::time::{Duration, Instant};

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use downwash::log::info::LogInfo;
use downwash::log::record::Record;
use downwash::log::{LogReader, LogSink, LogWriter};
use log_flight::{START, records, run_info, write};

fn log(c: &mut Criterion) {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench_log");
    let _ = std::fs::remove_dir_all(&directory);
    let second: Vec<Record> = records(1.0);
    let create = || {
        let _ = std::fs::remove_dir_all(&directory);
        LogWriter::create(&directory, &run_info(), START, Instant::now()).expect("create")
    };

    let mut group = c.benchmark_group("log");
    group.sample_size(30).warm_up_time(Duration::from_secs(1));
    group.measurement_time(Duration::from_secs(4));
    group.throughput(Throughput::Elements(second.len() as u64));
    // Without syncs, whose cost depends on the disk.
    let mut writer = create();
    group.bench_function("write_one_flight_second", |b| {
        b.iter(|| second.iter().for_each(|r| writer.write(r).expect("write")));
    });
    drop(writer);

    // The hand-over alone: fewer records than the queue holds, drained between the iterations.
    let tick = second.iter().find(|r| matches!(r, Record::Tick(_))).expect("a tick").clone();
    let mut sink = LogSink::threaded(create(), Vec::new()).expect("a thread");
    group.throughput(Throughput::Elements(100));
    group.bench_function("hand_over_100_ticks", |b| {
        b.iter_batched(
            || std::thread::sleep(Duration::from_millis(1)),
            |()| (0..100).for_each(|_| sink.log(tick.clone())),
            BatchSize::PerIteration,
        );
    });
    drop(sink);

    let _ = std::fs::remove_dir_all(&directory);
    let flight = records(20.0);
    let path = write(&directory, &flight);
    group.throughput(Throughput::Elements(flight.len() as u64));
    group.sample_size(10);
    group.bench_function("info_of_20_s", |b| {
        b.iter(|| LogInfo::read(&mut LogReader::open(&path).expect("open")).expect("read"));
    });
    group.finish();
}

criterion_group!(benches, log);
criterion_main!(benches);
