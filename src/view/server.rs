//! The server's thread: Foxglove's protocol behind the [`front`].

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use foxglove::websocket::{
    AnyClient, Capability, ChannelView, Client, GetParametersResponder, Parameter,
    ParameterHandler, PlaybackControlRequest, PlaybackState, ServerListener,
    SetParametersResponder,
};
use foxglove::{ChannelBuilder, Context, RawChannel, Schema, SinkId, WebSocketServerHandle};
use tokio::sync::oneshot;

use super::front::{self, Gate};
use super::write::{Changes, WRITABLE, Writer, shown_as};
use crate::http;
use crate::log::encoder::Definition;
use crate::offboard::Adjusted;

/// Messages that wait for one viewer; the oldest are dropped. Half a second of a busy flight.
const BACKLOG: usize = 1024;

/// Subscriptions kept until the feed takes them.
const NEWCOMERS_MAX: usize = 4096;
/// Time for viewers to receive the last messages.
const LINGER: Duration = Duration::from_millis(100);

/// Why a view cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The address is taken, or is not one of this machine's.
    #[error("cannot serve the view on {address}: {source}; choose another with --view=HOST:PORT")]
    Bind {
        /// The requested address.
        address: String,
        /// The system's reason.
        source: io::Error,
    },
    /// The system provided no thread or no socket.
    #[error("cannot start the view: {0}")]
    Start(#[from] io::Error),
    /// Foxglove's server did not start.
    #[error("cannot start the view: {0}")]
    Server(#[from] foxglove::FoxgloveError),
}

/// The address and content of the view.
#[derive(Clone, Debug, Default)]
pub struct ViewSettings {
    /// `HOST:PORT`; for port 0 the system chooses one.
    pub address: String,
    /// The source's name in viewers.
    pub name: String,
    /// The initial parameters; others are added later.
    pub parameters: BTreeMap<String, String>,
    /// First and last time of a playback, ns; `None` if live.
    pub playback: Option<(u64, u64)>,
    /// Whether viewers may move the goal and scale the feedback.
    pub is_writable: bool,
}

/// Answers a viewer's request to play, pause or seek.
pub(super) type OnPlayback = Box<dyn Fn(PlaybackControlRequest) -> PlaybackState + Send + Sync>;

/// State shared by the server's callbacks and the feed.
#[derive(Default)]
struct Shared {
    parameters: Mutex<BTreeMap<String, String>>,
    /// New subscriptions, by viewer and topic, since they were last taken.
    newcomers: Mutex<Vec<(SinkId, String)>>,
    has_newcomers: AtomicBool,
    on_playback: Option<OnPlayback>,
    writer: Option<Writer>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A running server. Dropping it ends the thread and closes all connections.
pub(super) struct Server {
    context: Arc<Context>,
    handle: WebSocketServerHandle,
    shared: Arc<Shared>,
    address: SocketAddr,
    changes: Mutex<Option<Changes>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts serving.
    pub fn start(
        settings: ViewSettings,
        on_playback: Option<OnPlayback>,
    ) -> Result<Self, ViewError> {
        let context = Context::new();
        let mut parameters = settings.parameters;
        let (writer, changes) = settings.is_writable.then(Writer::new).unzip();
        let gate = Gate::new(&settings.address, writer.as_ref().map(Writer::relayed));
        let mut info = HashMap::new();
        if writer.is_some() {
            parameters.extend(shown_as(&Adjusted::default()));
            info.insert("writable".to_owned(), WRITABLE.join(" "));
        }
        let parameters = Mutex::new(parameters);
        let shared = Arc::new(Shared { parameters, on_playback, writer, ..Shared::default() });
        let mut server = context
            .websocket_server()
            .name(settings.name)
            .server_info(info)
            // Viewers reach it only through the front.
            .bind("127.0.0.1", 0)
            .message_backlog_size(BACKLOG)
            .capabilities([Capability::Time])
            .parameter_handler(Arc::clone(&shared) as _)
            .listener(Arc::clone(&shared) as _);
        if let Some((first, last)) = settings.playback {
            server = server.playback_time_range(first, last);
        }
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (stop, stopped) = oneshot::channel();
        let (started, start) = sync_channel(1);
        let address = settings.address;
        let serve = async move {
            let running = async {
                let listener = http::bind(&address)
                    .await
                    .map_err(|source| ViewError::Bind { address, source })?;
                let at = listener.local_addr()?;
                Ok::<_, ViewError>((listener, at, server.start().await?))
            };
            match running.await {
                Err(error) => drop(started.send(Err(error))),
                Ok((listener, at, handle)) => {
                    let inner = SocketAddr::from(([127, 0, 0, 1], handle.port()));
                    if started.send(Ok((at, handle))).is_ok() {
                        tokio::select! {
                            () = front::serve(listener, inner, gate) => {}
                            // The last messages are still in transit.
                            _ = stopped => tokio::time::sleep(LINGER).await,
                        }
                    }
                }
            }
        };
        let thread =
            thread::Builder::new().name("view".into()).spawn(move || runtime.block_on(serve))?;
        let (address, handle) =
            start.recv().map_err(|_| io::Error::other("its thread ended before it started"))??;
        let (changes, stop) = (Mutex::new(changes), Some(stop));
        Ok(Self { context, handle, shared, address, changes, stop, thread: Some(thread) })
    }

    /// The queue of viewers' changes, if they may make any; `None` on a second call.
    pub fn take_changes(&self) -> Option<Changes> {
        lock(&self.changes).take()
    }

    /// Publishes the current values of the writable parameters.
    pub fn show_adjusted(&self, held: &Adjusted) {
        if self.shared.writer.is_none() {
            return;
        }
        let mut news = shown_as(held);
        let parameters = lock(&self.shared.parameters);
        news.retain(|(name, value)| parameters.get(name) != Some(value));
        drop(parameters);
        if !news.is_empty() {
            self.add_parameters(news);
        }
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether any viewer is connected.
    pub fn is_watched(&self) -> bool {
        self.handle.client_count() > 0
    }

    /// Advertises a topic to all viewers.
    pub fn advertise(&self, definition: &Definition) -> Result<Arc<RawChannel>, ViewError> {
        let Definition { topic, schema, descriptor } = definition;
        let schema = Schema::new(*schema, "protobuf", descriptor.clone());
        self.channel(topic, "protobuf", Some(schema))
    }

    /// The same, for messages of any encoding.
    pub fn channel(
        &self,
        topic: &str,
        encoding: &str,
        schema: Option<Schema>,
    ) -> Result<Arc<RawChannel>, ViewError> {
        let builder = ChannelBuilder::new(topic).context(&self.context);
        Ok(builder.message_encoding(encoding).schema(schema).build_raw()?)
    }

    /// Sends viewers the time, ns.
    pub fn send_time(&self, time: u64) {
        self.handle.broadcast_time(time);
    }

    /// Sends viewers the state of the playback.
    pub fn send_playback(&self, state: PlaybackState) {
        self.handle.broadcast_playback_state(state);
    }

    /// Adds parameters, or changes their values.
    pub fn add_parameters(&self, parameters: impl IntoIterator<Item = (String, String)>) {
        let added: Vec<_> = parameters.into_iter().collect();
        let shown = added.iter().map(|(name, value)| parameter(name, value)).collect();
        lock(&self.shared.parameters).extend(added);
        self.handle.publish_parameter_values(shown);
    }

    /// Takes the new subscriptions since the last call.
    pub fn take_newcomers(&self) -> Vec<(SinkId, String)> {
        // The flag avoids locking the mutex for every record.
        if !self.shared.has_newcomers.swap(false, Ordering::AcqRel) {
            return Vec::new();
        }
        std::mem::take(&mut lock(&self.shared.newcomers))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A parameter, as a number if its value is one.
fn parameter(name: &str, value: &str) -> Parameter {
    match value.parse::<f64>() {
        Ok(number) if number.is_finite() => Parameter::float64(name, number),
        _ => Parameter::string(name, value),
    }
}

impl ParameterHandler for Shared {
    fn get(
        &self,
        _: AnyClient,
        names: Vec<String>,
        _: Option<String>,
        responder: GetParametersResponder,
    ) {
        let parameters = lock(&self.parameters);
        let requested =
            parameters.iter().filter(|(name, _)| names.is_empty() || names.contains(name));
        responder.respond(requested.map(|(name, value)| parameter(name, value)).collect());
    }

    /// Queues the request and answers with the current values; accepted changes are published when
    /// the control thread has applied them.
    fn set(
        &self,
        _: AnyClient,
        requested: Vec<Parameter>,
        _: Option<String>,
        responder: SetParametersResponder,
    ) {
        if let Some(writer) = &self.writer {
            writer.offer(&requested);
        }
        let parameters = lock(&self.parameters);
        let held = requested.iter().filter_map(|Parameter { name, .. }| {
            parameters.get(name).map(|value| parameter(name, value))
        });
        responder.respond(held.collect());
    }
}

impl ServerListener for Shared {
    fn on_client_connect(&self) {
        self.writer.iter().for_each(Writer::viewer_connected);
    }

    fn on_client_disconnect(&self) {
        self.writer.iter().for_each(Writer::viewer_disconnected);
    }

    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        let Some(sink) = client.sink_id() else { return };
        let mut newcomers = lock(&self.newcomers);
        // They are not taken while no record arrives.
        if newcomers.len() < NEWCOMERS_MAX {
            newcomers.push((sink, channel.topic().to_owned()));
        }
        self.has_newcomers.store(true, Ordering::Release);
    }

    fn on_playback_control_request(
        &self,
        request: PlaybackControlRequest,
    ) -> Option<PlaybackState> {
        self.on_playback.as_ref().map(|answer| answer(request))
    }
}
