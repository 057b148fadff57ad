//! Three daemons that share a root, behind HAProxy and behind nginx with the configurations in `deploy/`.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use serde_json::json;

use super::client::Client;
use super::daemon::{Daemon, eventually, grid_ply, grid_scene, wall_ply};
use super::servers::{Balancer, Server};
use super::stream::{Came, Stream};

const BALANCERS: [Balancer; 2] = [Balancer::Haproxy, Balancer::Nginx];
/// Number of scenes in the shared root.
const SCENES: usize = 24;
const FOLLOWS: [&str; 4] = ["--follow-uploads", "--no-jobs", "--drain-delay", "2"];

/// Fills the keeper's root with scenes.
fn many_scenes(root: &std::path::Path) {
    let scene = grid_scene("grid.ply").to_string();
    for number in 0..SCENES {
        std::fs::write(root.join(format!("s{number}.json")), &scene).unwrap();
    }
}

/// A daemon that takes uploads and jobs.
fn keeper() -> Daemon {
    Daemon::start_in(many_scenes, &["--drain-delay", "2"])
}

/// A daemon that serves the scenes and uploads of the keeper's root.
fn follower(keeper: &Daemon) -> Daemon {
    let root = keeper.root();
    let share = |own: &std::path::Path| {
        std::fs::remove_dir_all(own).unwrap();
        std::os::unix::fs::symlink(root, own).unwrap();
    };
    Daemon::start_in(share, &FOLLOWS)
}

fn fleet() -> [Daemon; 3] {
    let keeper = keeper();
    let followers = [follower(&keeper), follower(&keeper)];
    let [second, third] = followers;
    [keeper, second, third]
}

fn addresses(daemons: &[Daemon; 3]) -> [std::net::SocketAddr; 3] {
    daemons.each_ref().map(|daemon| daemon.address)
}

fn frame_of(scene: &str, turn: u32) -> String {
    let eye = f64::from(turn) / 100.0;
    format!("/v1/scenes/{scene}/frame?w=32&h=32&format=raw&eye={eye},1,3&target=0,0,0")
}

/// Frames that a daemon has sent.
fn sent(daemon: &Daemon) -> f64 {
    sent_by(&daemon.client())
}

fn sent_by(client: &Client) -> f64 {
    client.metric("pointillist_frames_sent_total")
}

/// Requests a new frame of every scene, and returns which of the living daemons sent it.
fn owners(balancer: &Server, daemons: &[(usize, &Daemon)], turn: u32) -> Vec<usize> {
    let client = balancer.client();
    let owner = |number| {
        let before: Vec<f64> = daemons.iter().map(|(_, daemon)| sent(daemon)).collect();
        let reply = client.get(&frame_of(&format!("s{number}"), turn));
        assert_eq!(reply.status, 200, "s{number}: {}", reply.text());
        let grown: Vec<usize> = daemons
            .iter()
            .zip(before)
            .filter(|((_, daemon), before)| sent(daemon) > *before)
            .map(|((index, _), _)| *index)
            .collect();
        assert_eq!(grown.len(), 1, "s{number}: one daemon sends one frame");
        grown[0]
    };
    (0..SCENES).map(owner).collect()
}

#[test]
fn a_scene_stays_with_its_server_and_only_the_scenes_of_a_lost_server_move() {
    for kind in BALANCERS {
        let mut daemons = fleet();
        let Some(balancer) = kind.start(addresses(&daemons)) else { continue };
        let all: Vec<(usize, &Daemon)> = daemons.iter().enumerate().collect();
        let first = owners(&balancer, &all, 0);
        assert_eq!(owners(&balancer, &all, 1), first, "{kind:?}");
        let lost = *first.iter().find(|owner| **owner != 0).expect("scenes of several servers");
        assert!(first.iter().any(|owner| *owner != lost), "{kind:?}: {first:?}");
        daemons[lost].kill();
        let rest: Vec<(usize, &Daemon)> =
            daemons.iter().enumerate().filter(|(index, _)| *index != lost).collect();
        let now = owners(&balancer, &rest, 2);
        for (scene, (before, after)) in first.iter().zip(&now).enumerate() {
            if *before != lost {
                assert_eq!(before, after, "{kind:?}: s{scene} moved although its server is there");
            }
        }
    }
}

/// Reads up to the frame of full quality, and returns its image.
fn still(stream: &mut Stream) -> Vec<u8> {
    loop {
        match stream.try_next().expect("a frame") {
            Came::Frame { header, image } => {
                stream.send(json!({"ack": header["frame"]}));
                if header["quality"] == "still" {
                    return image;
                }
            }
            Came::Event(_) => {}
            Came::Close(code) => panic!("closed with {code}"),
        }
    }
}

#[test]
fn no_request_is_lost_while_one_drains_and_streams_go_on_elsewhere() {
    for kind in BALANCERS {
        let mut daemons = fleet();
        let Some(balancer) = kind.start(addresses(&daemons)) else { continue };
        let all: Vec<(usize, &Daemon)> = daemons.iter().enumerate().collect();
        let owner = owners(&balancer, &all, 0)[0];
        let others: Vec<usize> = (0..3).filter(|index| *index != owner).collect();
        let view = "/v1/scenes/s0/stream?w=64&h=64&format=png&eye=0.3,0.2,3&target=0,0,0";
        let mut stream = Stream::connect(balancer.address, view, &[]).unwrap();
        let shown = still(&mut stream);
        let elsewhere = |daemons: &[Daemon; 3]| -> f64 {
            let of =
                |index: &usize| daemons[*index].client().metric("pointillist_stream_frames_total");
            others.iter().map(of).sum()
        };
        let before = elsewhere(&daemons);

        let (stop, answered) = (AtomicBool::new(false), AtomicU32::new(0));
        let statuses: Vec<u16> = std::thread::scope(|scope| {
            let clients: Vec<_> = (0..4)
                .map(|number: u32| {
                    let (balancer, stop, answered) = (&balancer, &stop, &answered);
                    scope.spawn(move || {
                        let mut statuses = Vec::new();
                        while !stop.load(Ordering::Relaxed) {
                            // Half of the clients use one connection per request, which a server about to end would refuse.
                            let client = balancer.client();
                            for turn in 0..1 + number % 2 * 20 {
                                let scene = format!("s{}", (turn + number) % 6);
                                statuses.push(client.get(&frame_of(&scene, turn)).status);
                                answered.fetch_add(1, Ordering::Relaxed);
                            }
                        }
                        statuses
                    })
                })
                .collect();
            let more = |count: u32| {
                let until = answered.load(Ordering::Relaxed) + count;
                eventually("answers", || answered.load(Ordering::Relaxed) >= until);
            };
            more(50);
            daemons[owner].signal();
            assert_eq!(stream.closed(), 1001, "{kind:?}: the client is told to connect again");
            assert!(daemons[owner].wait().success(), "{}", daemons[owner].log());
            more(50);
            stop.store(true, Ordering::Relaxed);
            clients.into_iter().flat_map(|client| client.join().unwrap()).collect()
        });
        let lost = statuses.iter().filter(|status| **status != 200).count();
        assert_eq!(lost, 0, "{kind:?}: of {}", statuses.len());
        // The first try reaches another server, which shows the same view.
        let mut again = Stream::connect(balancer.address, view, &[]).unwrap();
        assert!(still(&mut again) == shown, "{kind:?}: the view stays");
        assert!(elsewhere(&daemons) > before, "{kind:?}");
    }
}

#[test]
fn a_server_that_loads_gets_no_traffic() {
    for kind in BALANCERS {
        let keeper = keeper();
        let second = follower(&keeper);
        let mut third = follower(&keeper);
        let place = third.address;
        // The third server starts again, with a cloud that takes a while to load. Its port is a new one.
        third.kill();
        std::fs::write(keeper.root().join("slow.ply"), wall_ply(1600)).unwrap();
        let slow = grid_scene("slow.ply").to_string();
        // First in the order of names: all other scenes wait for it.
        std::fs::write(keeper.root().join("a.json"), slow).unwrap();
        let mut asked = 0;
        let loaded = third.start_again_asking(&FOLLOWS, |address| {
            assert_ne!(address, place);
            let servers = [keeper.address, second.address, address];
            let Some(balancer) = kind.start(servers) else { return };
            let own = Client::new(address);
            let client = balancer.client();
            // As long as its first scene is being loaded, the others are not there.
            let is_loading = || own.get("/v1/scenes/a").json()["state"] == "loading";
            while is_loading() && asked < 3 * SCENES {
                let scene = format!("s{}", asked % SCENES);
                let turn = u32::try_from(asked / SCENES).unwrap();
                let reply = client.get(&frame_of(&scene, turn));
                assert_eq!(reply.status, 200, "{kind:?} {scene}: {}", reply.text());
                let (ready, frames) = (own.get("/readyz"), sent_by(&own));
                if is_loading() {
                    assert_eq!(frames, 0.0, "{kind:?} {scene}");
                    // The server is alive all the same.
                    assert_eq!(own.get("/healthz").status, 200);
                    assert_eq!(ready.status, 503);
                    assert!(ready.text().contains("loading scenes"), "{}", ready.text());
                    asked += 1;
                }
            }
            assert!(asked >= 3, "{kind:?}: only {asked} requests while a server loaded");
        });
        drop(loaded);
    }
}

/// A follower repeats a load that fails, and meanwhile answers so that a balancer asks another server.
#[test]
fn a_follower_tries_again_to_load_an_upload() {
    let keeper = keeper();
    let ply = grid_ply();
    let path = "/v1/scenes?id=up&name=a.ply";
    let uploaded = keeper.client().send("POST", path, &[], Some(ply.as_bytes()));
    assert_eq!(uploaded.status, 201, "{}", uploaded.text());
    // The follower's disk shows something else under the upload's time.
    let file = keeper.root().join("uploads/up/a.ply");
    let modified = std::fs::metadata(&file).unwrap().modified().unwrap();
    let write = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let opened = std::fs::File::options().append(true).open(&file).unwrap();
        opened.set_modified(modified).unwrap();
    };
    write("no ply");
    let follower = follower(&keeper);
    let client = follower.client();
    assert_eq!(client.get("/v1/scenes/up").json()["state"], "failed");
    let refused = client.get(&frame_of("up", 0));
    assert_eq!(refused.status, 503, "{}", refused.text());
    assert!(refused.text().contains("tries again"), "{}", refused.text());
    assert!(refused.header("retry-after").is_some());
    write(&ply);
    eventually("the load", || client.get(&frame_of("up", 0)).status == 200);
}

#[test]
fn an_upload_reaches_every_server() {
    for kind in BALANCERS {
        let daemons = fleet();
        let Some(balancer) = kind.start(addresses(&daemons)) else { continue };
        let client = balancer.client();
        let upload = |ply: String| {
            let reply =
                client.send("POST", "/v1/scenes?id=up&name=a.ply", &[], Some(ply.as_bytes()));
            assert_eq!(reply.status, 201, "{kind:?}: {}", reply.text());
        };
        let frame = frame_of("up", 1);
        upload(grid_ply());
        // A server that has not loaded the upload yet says when to ask again.
        eventually("a frame through the balancer", || {
            let reply = client.get(&frame);
            let waits = reply.status == 409 && reply.header("retry-after") == Some("1");
            assert!(waits || reply.status == 200, "{kind:?}: {} {}", reply.status, reply.text());
            reply.status == 200
        });
        let of_all = || -> Vec<(Option<String>, Vec<u8>)> {
            let of = |daemon: &Daemon| {
                let client = daemon.client();
                eventually("a frame of each server", || client.get(&frame).status == 200);
                let reply = client.get(&frame);
                (reply.header("etag").map(str::to_owned), reply.body)
            };
            daemons.iter().map(of).collect()
        };
        let first = of_all();
        assert!(first.iter().all(|answer| *answer == first[0]), "{kind:?}: frame and entity tag");
        // Others than the keeper change nothing.
        let refused = daemons[1].client().send("DELETE", "/v1/scenes/up", &[], None);
        assert_eq!(refused.status, 503);
        assert_eq!(refused.problem()["type"], "urn:pointillist:problem:uploads-off");
        let refused = daemons[1].client().send("POST", "/v1/scenes?name=b.ply", &[], Some(b"ply"));
        assert_eq!(refused.status, 503);

        assert_eq!(client.send("DELETE", "/v1/scenes/up", &[], None).status, 204, "{kind:?}");
        upload(wall_ply(5));
        let answers = |daemon: &Daemon| daemon.client().get(&frame).body;
        eventually("the new upload everywhere", || {
            let all = daemons.each_ref().map(answers);
            all[0] != first[0].1 && all.iter().all(|body| *body == all[0])
        });
        assert_eq!(client.send("DELETE", "/v1/scenes/up", &[], None).status, 204, "{kind:?}");
        for daemon in &daemons {
            eventually("its end", || daemon.client().get(&frame).status == 404);
        }
        // Jobs are the keeper's, whatever their ids.
        let job = json!({"scene": "s1", "path": "past", "w": 16, "h": 16});
        let reply = client.post_json("/v1/jobs", &job);
        assert_eq!(reply.status, 201, "{kind:?}: {}", reply.text());
        let place = reply.header("location").unwrap().to_owned();
        assert_eq!(client.get(&place).status, 200, "{kind:?}");
    }
}

/// Browsers send the origin of a page with its port, and the server compares it with the name that it was called by.
#[test]
fn a_page_may_change_scenes_through_a_balancer() {
    for kind in BALANCERS {
        let daemon = Daemon::start(&[]);
        let Some(balancer) = kind.start([daemon.address; 3]) else { continue };
        let (client, ply) = (balancer.client(), grid_ply());
        let origin = format!("http://{}", balancer.address);
        let headers = [("origin", origin.as_str())];
        let path = "/v1/scenes?id=own&name=a.ply";
        let reply = client.send("POST", path, &headers, Some(ply.as_bytes()));
        assert_eq!(reply.status, 201, "{kind:?}: {}", reply.text());
        assert_eq!(client.get("/metrics").status, 200, "{kind:?}");
    }
}

/// The client's own address is that of a trusted proxy here.
#[test]
fn nginx_passes_no_forged_address_on() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("access.log");
    let args = ["--trusted-proxies", "127.0.0.1", "--access-log", log.to_str().unwrap()];
    let daemon = Daemon::start(&args);
    let Some(balancer) = Balancer::Nginx.start([daemon.address; 3]) else { return };
    let forged = [("x-forwarded-for", "192.0.2.1")];
    assert_eq!(balancer.client().send("GET", "/v1/scenes/grid", &forged, None).status, 200);
    let logged = || std::fs::read_to_string(&log).unwrap();
    // The line is written when the answer has been sent.
    eventually("a line", || logged().contains("\"target\":\"grid\""));
    assert!(!logged().contains("192.0.2.1"), "{}", logged());
}

/// If a default daemon refused the health check, no server would be up.
#[test]
fn all_servers_gone_is_said() {
    for kind in BALANCERS {
        let mut daemon = Daemon::start(&[]);
        let Some(balancer) = kind.start([daemon.address; 3]) else { continue };
        let client = balancer.client();
        let frame = frame_of("grid", 0);
        eventually("a server", || client.get(&frame).status == 200);
        assert!(daemon.terminate().success());
        let status = if kind == Balancer::Haproxy { 503 } else { 502 };
        eventually("none", || {
            // nginx keeps frames for a second.
            client.get(&frame).status == status
        });
    }
}
