//! The connection to the NATS server: a JetStream work queue of runs, and plain subjects for notes and beats.
//!
//! Only servers create the stream and the consumer of their kind. Workers wait until both exist: NATS 2.9 stops
//! answering pulls when several clients create a consumer at the same time. Nothing here needs a newer version.
//!
//! A NATS server that is down or restarts is no error: the connection is made anew, and every request has a time limit after
//! which the caller tries again.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use async_nats::connection::State;
use async_nats::jetstream::consumer::{AckPolicy, PullConsumer, pull};
use async_nats::jetstream::context::Context;
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::{
    self, ConsumerError, ConsumerErrorKind, RetentionPolicy, StorageType,
};
use async_nats::jetstream::{self, ErrorCode, Message};
use async_nats::{Client, ClientError, ConnectOptions, Event, ServerAddr, Subscriber};
use bytes::Bytes;
use futures::StreamExt;
use percent_encoding::percent_decode_str;
use serde::Serialize;
use tokio::net::TcpStream;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject;

use super::Said;
use super::messages::{RUNS, Run, STREAM, runs, runs_of};
use super::pacing::{ACK_WAIT, PULL};
use crate::jobs::Queued;

/// Time limit of a request to the server.
const REQUEST: Duration = Duration::from_secs(5);
/// Time after which a worker pulls anew even if the server is silent.
const PULL_LIMIT: Duration = Duration::from_secs(8);
/// Time for which the server recognises a message that is published again.
const DUPLICATES: Duration = Duration::from_secs(120);
/// Number of times that stream and consumer must disagree before the consumer is recreated.
const LOOKS: usize = 5;
/// Pause before a count of runs is repeated.
const LOOK_AGAIN: Duration = Duration::from_millis(500);
/// Time limit of a look at whether the server takes connections.
const PROBE: Duration = Duration::from_secs(2);
/// Age at which the server forgets a run that nobody draws.
const MOST_AGE: Duration = Duration::from_secs(14 * 24 * 3600);
/// Runs that workers of a kind may draw at a time.
const MOST_UNACKED: i64 = 20_000;
/// Workers of a kind that may wait for a run at a time. The server refuses the pulls of all others; its own default is 512.
const MOST_IDLE: i64 = 20_000;

/// How to reach the broker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// `nats://HOST:PORT` or `tls://HOST:PORT`; several, of a cluster, are separated by commas.
    pub url: String,
    /// File of a user's JWT and seed, as `nsc` writes it.
    pub credentials: Option<PathBuf>,
    /// Certificates, in PEM form, that sign the server's own.
    pub ca: Option<PathBuf>,
}

impl Address {
    /// Returns the address without user names and passwords, for logs and errors.
    pub fn without_secrets(&self) -> String {
        let servers = self.url.split(',').map(|server| {
            let (scheme, rest) =
                server.split_once("://").map_or(("", server), |(s, rest)| (s, rest));
            let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
            if scheme.is_empty() { host.to_owned() } else { format!("{scheme}://{host}") }
        });
        servers.collect::<Vec<_>>().join(",")
    }
}

/// Error of the broker.
#[derive(Debug, thiserror::Error)]
pub enum BrokerError {
    #[error("--nats-credentials {}: {error}", file.display())]
    Credentials { file: PathBuf, error: std::io::Error },
    #[error("--nats-ca {}: {error}; expected certificates in PEM form", file.display())]
    Ca { file: PathBuf, error: String },
    #[error("--nats {url}: {error}; expected nats://HOST:PORT")]
    Address { url: String, error: String },
    #[error("request to the NATS server failed ({what}): {error}")]
    Request { what: &'static str, error: String },
}

fn failed<E: std::fmt::Display>(what: &'static str) -> impl FnOnce(E) -> BrokerError {
    move |error| {
        let mut error = error.to_string();
        if error.contains("jetstream")
            && (error.contains("not enabled") || error.contains("unavailable"))
        {
            error.push_str("; enable JetStream: start nats-server with -js, or put `jetstream {}` into its configuration file");
        }
        BrokerError::Request { what, error }
    }
}

/// Checks that a file has certificates.
fn check_certificates(file: &std::path::Path) -> Result<(), String> {
    let found = CertificateDer::pem_file_iter(file)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| error.to_string())?;
    if found.is_empty() { Err("there are none in the file".to_owned()) } else { Ok(()) }
}

/// Logs what happens to a connection.
struct Reporter {
    servers: Vec<ServerAddr>,
    address: String,
    has_tls: bool,
    said: Said,
}

impl Reporter {
    async fn hear(&self, event: Event) {
        let address = &self.address;
        let text = match event {
            Event::Connected => {
                self.said.forget();
                tracing::info!("connected to the NATS server {address}");
                return;
            }
            Event::Draining | Event::Closed => return,
            Event::Disconnected => "connection lost; reconnecting".to_owned(),
            Event::ClientError(ClientError::Other(error)) => self.cause(&error).await,
            event => event.to_string(),
        };
        if self.said.is_due(&text) {
            tracing::warn!("NATS server {address}: {text}");
        }
    }

    /// Why no connection is made. The client itself says no more than that it had an error.
    async fn cause(&self, error: &str) -> String {
        for server in &self.servers {
            let place = (server.host(), server.port());
            let tried = tokio::time::timeout(PROBE, TcpStream::connect(place)).await;
            let reached = tried.unwrap_or_else(|_| Err(std::io::ErrorKind::TimedOut.into()));
            if let Err(error) = reached {
                return format!("cannot connect: {error}; retrying");
            }
        }
        let hint = if self.has_tls {
            "; it takes connections, so look at its log, and whether its certificate is for this name and signed by --nats-ca or by an authority that this system trusts"
        } else {
            "; it takes connections, so look at its log"
        };
        format!("{error}{hint}")
    }
}

/// A connection; clones share it.
#[derive(Clone)]
pub struct Broker {
    client: Client,
    context: Context,
}

impl Broker {
    /// Prepares a connection, which is made in the background, now and whenever it breaks.
    ///
    /// # Errors
    /// The address or a file cannot be used.
    pub async fn connect(address: &Address, name: &str) -> Result<Broker, BrokerError> {
        let url = &address.url;
        let unusable = |error: String| {
            // The error may repeat the password.
            let error = if url.contains('@') { "not an address".to_owned() } else { error };
            BrokerError::Address { url: address.without_secrets(), error }
        };
        let servers: Vec<async_nats::ServerAddr> = url
            .split(',')
            .map(|server| server.trim().parse())
            .collect::<Result<_, std::io::Error>>()
            .map_err(|error| unusable(error.to_string()))?;
        let reporter = Arc::new(Reporter {
            has_tls: address.ca.is_some() || servers.iter().any(ServerAddr::tls_required),
            servers: servers.clone(),
            address: address.without_secrets(),
            said: Said::default(),
        });
        let mut options = ConnectOptions::new()
            .name(name)
            .retry_on_initial_connect()
            .request_timeout(Some(REQUEST))
            .event_callback(move |event| {
                let reporter = reporter.clone();
                async move { reporter.hear(event).await }
            });
        // The client does not look for a user in the address by itself.
        let user = servers.iter().find_map(|server| server.username().zip(server.password()));
        if let Some((user, password)) = user {
            let [user, password] = [user, password]
                .map(|text| percent_decode_str(text).decode_utf8_lossy().into_owned());
            options = options.user_and_password(user, password);
        }
        if let Some(file) = &address.credentials {
            let read = options.credentials_file(file).await;
            options =
                read.map_err(|error| BrokerError::Credentials { file: file.clone(), error })?;
        }
        if let Some(file) = &address.ca {
            check_certificates(file)
                .map_err(|error| BrokerError::Ca { file: file.clone(), error })?;
            options = options.add_root_certificates(file.clone()).require_tls(true);
        }
        let client = options.connect(servers).await.map_err(|error| unusable(error.to_string()))?;
        let context = jetstream::new(client.clone());
        Ok(Broker { client, context })
    }

    /// Returns whether there is a connection now.
    pub fn is_connected(&self) -> bool {
        self.client.connection_state() == State::Connected
    }

    /// Creates the stream, and the consumer of a kind, unless they exist. For servers only.
    ///
    /// # Errors
    /// The server does not answer or refuses, as in all other requests.
    pub async fn prepare(&self, kind: &str) -> Result<(), BrokerError> {
        let stream = self
            .context
            .get_or_create_stream(stream::Config {
                name: STREAM.to_owned(),
                subjects: vec![RUNS.to_owned()],
                retention: RetentionPolicy::WorkQueue,
                storage: StorageType::File,
                duplicate_window: DUPLICATES,
                max_age: MOST_AGE,
                ..stream::Config::default()
            })
            .await
            .map_err(failed("create the stream"))?;
        let consumer = pull::Config {
            durable_name: Some(kind.to_owned()),
            filter_subject: runs_of(kind),
            ack_policy: AckPolicy::Explicit,
            ack_wait: ACK_WAIT,
            // A message beyond a limit would disappear without a word. The store counts tries.
            max_deliver: -1,
            max_ack_pending: MOST_UNACKED,
            max_waiting: MOST_IDLE,
            ..pull::Config::default()
        };
        let created = stream.get_or_create_consumer(kind, consumer).await;
        created.map_err(failed("create the consumer"))?;
        Ok(())
    }

    /// Recreates the consumer of a kind if it skips runs, and returns whether it did. After a kill, the NATS server may have lost the stream's last
    /// sequence number but kept the one that the consumer has acknowledged. It then reuses sequence numbers, and the consumer skips messages until
    /// they exceed the acknowledged one.
    pub async fn mend(&self, kind: &str) -> Result<bool, BrokerError> {
        // An earlier mending may have ended after the consumer was removed.
        self.prepare(kind).await?;
        for _ in 0..LOOKS {
            // Runs may be queued and finished between the requests.
            let before = self.known_to_consumer(kind).await?;
            let in_stream = self.in_stream(kind).await?;
            if in_stream <= before.max(self.known_to_consumer(kind).await?) {
                return Ok(false);
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
        let stream = self.context.get_stream_no_info(STREAM).await;
        let stream = stream.map_err(failed("find the stream"))?;
        stream.delete_consumer(kind).await.map_err(failed("remove the consumer"))?;
        self.prepare(kind).await?;
        Ok(true)
    }

    /// Returns the number of runs of a kind in the stream.
    async fn in_stream(&self, kind: &str) -> Result<u64, BrokerError> {
        let stream = self.context.get_stream_no_info(STREAM).await;
        let stream = stream.map_err(failed("find the stream"))?;
        let subjects = stream.info_with_subjects(runs_of(kind)).await;
        let mut subjects = subjects.map_err(failed("count runs"))?;
        let mut runs = 0;
        while let Some(subject) = subjects.next().await {
            runs += subject.map_err(failed("count runs"))?.1 as u64;
        }
        Ok(runs)
    }

    /// Returns the number of runs that the consumer of a kind will deliver or has delivered.
    async fn known_to_consumer(&self, kind: &str) -> Result<u64, BrokerError> {
        let queued = self.queued(kind).await?;
        Ok(queued.pending + queued.drawing)
    }

    /// Queues a run. The server drops a second message with the same [`Run::message_id`].
    pub async fn queue(&self, kind: &str, run: &Run) -> Result<(), BrokerError> {
        let message = PublishMessage::build().payload(json(run)).message_id(run.message_id());
        let published = async {
            let sent = self.context.send_publish(runs(kind, &run.film), message).await;
            sent.map_err(failed("queue a run"))?.await.map_err(failed("queue a run"))
        };
        tokio::time::timeout(REQUEST, published).await.map_err(failed("queue a run"))??;
        Ok(())
    }

    /// Removes a film's runs from the queue.
    pub async fn purge(&self, kind: &str, film: &str) -> Result<(), BrokerError> {
        let stream = self.context.get_stream_no_info(STREAM).await;
        let stream = stream.map_err(failed("find the stream"))?;
        let purged = stream.purge().filter(runs(kind, film)).await;
        purged.map_err(failed("remove runs"))?;
        Ok(())
    }

    /// Returns how many runs of a kind there are. Before the first film there is no consumer, and nothing is queued.
    pub async fn queued(&self, kind: &str) -> Result<Queued, BrokerError> {
        let found: Result<PullConsumer, ConsumerError> =
            self.context.get_consumer_from_stream(kind, STREAM).await;
        let consumer = match found {
            Ok(consumer) => consumer,
            Err(error) if is_missing(&error) => return Ok(Queued::default()),
            Err(error) => return Err(failed("find the consumer")(error)),
        };
        let info = consumer.cached_info();
        Ok(Queued {
            pending: info.num_pending,
            drawing: info.num_ack_pending as u64,
            redelivered: info.num_redelivered as u64,
        })
    }

    /// Returns the consumer of a kind, which a server has created.
    pub async fn consumer(&self, kind: &str) -> Result<PullConsumer, BrokerError> {
        let found = self.context.get_consumer_from_stream(kind, STREAM).await;
        found.map_err(failed("find the consumer"))
    }

    /// Sends a message that need not arrive.
    pub async fn tell<T: Serialize>(&self, subject: String, message: &T) {
        // While the connection is broken, this waits for room; what follows is not worth that.
        let sent = self.client.publish(subject, json(message));
        let _ = tokio::time::timeout(REQUEST, sent).await;
    }

    /// Subscribes to messages that need not arrive.
    pub async fn hear(&self, subject: &str) -> Result<Subscriber, BrokerError> {
        self.client.subscribe(subject.to_owned()).await.map_err(failed("subscribe"))
    }

    /// Sends everything that waits to be sent.
    pub async fn flush(&self) {
        let _ = tokio::time::timeout(REQUEST, self.client.flush()).await;
    }
}

/// Returns whether the server answered that there is no such consumer, or no stream.
fn is_missing(error: &ConsumerError) -> bool {
    let missing = [ErrorCode::CONSUMER_NOT_FOUND, ErrorCode::STREAM_NOT_FOUND];
    matches!(error.kind(), ConsumerErrorKind::JetStream(answer) if missing.contains(&answer.error_code()))
}

/// Waits for a run; `None` if there is none for a while.
///
/// # Errors
/// The server refuses the pull or does not answer at all.
pub async fn pull(consumer: &PullConsumer) -> Result<Option<Message>, BrokerError> {
    let pulled = async {
        let batch = consumer.batch().max_messages(1).expires(PULL).messages().await;
        let mut batch = batch.map_err(failed("pull a run"))?;
        batch.next().await.transpose().map_err(failed("pull a run"))
    };
    tokio::time::timeout(PULL_LIMIT, pulled).await.map_err(failed("pull a run"))?
}

/// Formats a message. Our messages have only strings and numbers, which always have a JSON text.
fn json<T: Serialize>(message: &T) -> Bytes {
    serde_json::to_vec(message).unwrap_or_default().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logs_get_no_passwords() {
        let shown = |url: &str| {
            Address { url: url.to_owned(), credentials: None, ca: None }.without_secrets()
        };
        assert_eq!(shown("nats://127.0.0.1:4222"), "nats://127.0.0.1:4222");
        assert_eq!(shown("tls://ann:p@ss@a:4222,tls://bob:x@b"), "tls://a:4222,tls://b");
        assert_eq!(shown("ann:secret@a"), "a");
    }

    #[tokio::test]
    async fn certificates_are_looked_at_before_they_are_needed() {
        let refusal = async |file: &str| {
            let url = "tls://127.0.0.1:1".to_owned();
            let address = Address { url, credentials: None, ca: Some(file.into()) };
            Broker::connect(&address, "test").await.err().unwrap().to_string()
        };
        let missing = refusal("/no/such.pem").await;
        assert!(missing.starts_with("--nats-ca /no/such.pem: "), "{missing}");
        let file = tempfile::NamedTempFile::new().unwrap();
        let none = refusal(file.path().to_str().unwrap()).await;
        assert!(none.contains("there are none in the file"), "{none}");
    }

    /// The server's answers as they come over the wire, and the lack of one.
    #[test]
    fn only_an_answer_says_that_nothing_is_queued() {
        let answered = |code: u64| {
            let text = format!(r#"{{"code": 404, "err_code": {code}, "description": "no"}}"#);
            let answer: jetstream::Error = serde_json::from_str(&text).unwrap();
            is_missing(&ConsumerError::from(answer))
        };
        assert!(answered(10014) && answered(10059));
        assert!(!answered(10008), "JetStream is temporarily unavailable");
        let silent = [ConsumerErrorKind::TimedOut, ConsumerErrorKind::Request];
        assert!(!silent.map(ConsumerError::new).iter().any(is_missing));
    }

    #[tokio::test]
    async fn errors_of_addresses_hold_no_password() {
        let url = "nats://ann:secret@a b:4222".to_owned();
        let address = Address { url, credentials: None, ca: None };
        let error = Broker::connect(&address, "test").await.err().unwrap().to_string();
        assert!(!error.contains("secret") && error.contains("nats://a b:4222"), "{error}");
    }
}
