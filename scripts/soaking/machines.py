"""The processes of a soak, what is done to them, and how much memory they use."""

import hashlib
import os
import signal
import statistics
import time
from contextlib import contextmanager

from processes import Processes, free_port, nats_command, write_wall
from soaking.clients import Actor
from soaking.fresh import await_ready
from soaking.wire import Caller, Gone

KEY, ROGUES_KEY, PATIENCE = "soak-key", "rogues-key", 120
# Share of growth that is still flat, with enough samples and with few.
FLAT, ROUGHLY_FLAT, ENOUGH = 0.01, 0.15, 10


class Cluster(Processes):
    """A broker, a daemon and workers."""

    def __init__(self, program, folder, disk, workers, upload_mib, scenes):
        super().__init__(folder)
        self.program, self.disk = program, disk
        self.root = disk / "root"
        for made in (self.root, disk / "state", disk / "store"):
            made.mkdir(parents=True)
        write_wall(self.root, 60, 2500)
        for file in scenes.glob("part*"):
            (self.root / file.name).write_bytes(file.read_bytes())
        self.nats_port, self.port = free_port(), free_port()
        self.workers = [f"worker-{number}" for number in range(workers)]
        self.upload_mib, self.guest, self.keys = upload_mib, 0, folder / "keys"
        self.write_keys()

    def write_keys(self):
        line = lambda name, scope, key: f"{name} {scope} {hashlib.sha256(key.encode()).hexdigest()}\n"
        # Rogues have a key of their own, so that the others get their share of the device.
        keys = [("soak", "admin", KEY), ("rogues", "read", ROGUES_KEY), ("guest", "read", f"guest-{self.guest}")]
        self.keys.write_text("".join(line(*key) for key in keys))

    def start(self, name):
        shared = ["--nats", f"nats://127.0.0.1:{self.nats_port}", "--store", str(self.disk / "store"), "--no-cache", "--no-prime"]
        lose = {"POINTILLIST_LOSE_DEVICE": str(self.folder / f"{name}.lose")}
        if name == "broker":
            self.spawn(name, nats_command(self.folder / "nats", self.nats_port))
        elif name == "daemon":
            self.spawn(name, [
                self.program, "serve", "--listen", f"127.0.0.1:{self.port}", "--root", str(self.root),
                "--state", str(self.disk / "state"), "--api-keys", str(self.keys), "--max-upload-mib", str(self.upload_mib),
                "--queue", "64", "--max-connections", "300", "--max-connections-per-address", "20",
                "--requests-per-second-per-address", "60", "--max-streams", "6", "--read-timeout-seconds", "5",
                "--drain-seconds", "10", "--host-memory-mib", "1024", "--gpu-budget-mib", "256", *shared,
            ], **lose)
        else:
            self.spawn(name, [self.program, "worker", *shared], **lose)

    def restart(self, name, how=signal.SIGKILL):
        status = self.end(name, how, PATIENCE)
        self.start(name)
        return status

    def lose_device(self, name):
        """Has a process lose its device, and tells whether it did."""
        file = self.folder / f"{name}.lose"
        file.touch()
        until = time.monotonic() + PATIENCE
        while file.exists() and time.monotonic() < until:
            time.sleep(0.02)
        return not file.exists()

    def fill_disk(self, number):
        """Takes all space that is left on the small disk."""
        with open(self.disk / f"filler-{number}", "ab") as file:
            size = 1 << 22
            while size >= 512:
                try:
                    os.posix_fallocate(file.fileno(), os.fstat(file.fileno()).st_size, size)
                except OSError:
                    size //= 2

    def empty_disk(self):
        for file in self.disk.glob("filler-*"):
            file.unlink()


class Faults(Actor):
    """Does everything to the processes that happens to processes, in random order, each as often as the others."""

    # While memory is measured, the daemon and the first worker live on.
    GENTLE = ("kill_worker", "stop_worker", "kill_broker", "freeze_broker", "hang_up", "full_disk", "lose_device", "lose_worker_device")
    HARD = ("kill_daemon", "drain_daemon", "kill_daemon", "kill_all")

    def __init__(self, soak, name, number):
        super().__init__(soak, name, number)
        self.cluster, self.bag, self.is_hard = soak.cluster, [], False
        self.fillers = 0

    def step(self):
        self.world.pause(self.chance.uniform(*self.soak.pace))
        if self.world.running.is_set() and not self.world.ended.is_set():
            self.next()

    def next(self):
        if not self.bag:
            self.bag = self.kinds(self.is_hard)
            self.chance.shuffle(self.bag)
        deed = self.bag.pop()
        self.world.say(f"fault: {deed.replace('_', ' ')}")
        getattr(self, deed)()
        self.world.count(f"fault: {deed.replace('_', ' ')}")

    def kinds(self, is_hard):
        """Faults that can be made here."""
        left_out = [*self.soak.options.without, *([] if self.soak.has_small_disk else ["full_disk"])]
        return [deed for deed in self.GENTLE + (self.HARD if is_hard else ()) if deed not in left_out]

    def worker(self):
        return self.chance.choice(self.cluster.workers if self.is_hard else self.cluster.workers[1:])

    @contextmanager
    def ending_workers(self):
        """Notes that workers end or lose their device meanwhile, which may set frames aside."""
        self.world.begin(self.world.worker_ends)
        try:
            yield
        finally:
            self.world.finish(self.world.worker_ends)

    def kill_worker(self):
        with self.ending_workers():
            self.cluster.restart(self.worker())

    def stop_worker(self):
        name = self.worker()
        if self.cluster.restart(name, signal.SIGTERM) != 0:
            self.world.fault("lost process", f"{name} did not end well after SIGTERM")

    def kill_broker(self):
        self.cluster.end("broker", signal.SIGKILL)
        self.world.pause(self.chance.uniform(0, 1))
        self.cluster.start("broker")

    def freeze_broker(self):
        broker = self.cluster.processes["broker"]
        broker.send_signal(signal.SIGSTOP)
        self.world.pause(self.chance.uniform(0.5, 3))
        broker.send_signal(signal.SIGCONT)

    def lose_device(self):
        if not self.cluster.lose_device("daemon"):
            self.world.fault("lost process", "the daemon did not lose its device when told to: is the program a release build?")

    def lose_worker_device(self):
        name = self.worker()
        with self.ending_workers():
            if not self.cluster.lose_device(name):
                self.world.fault("lost process", f"{name} did not lose its device when told to")

    def hang_up(self):
        """Another guest key: the old one is refused from then on."""
        old = f"guest-{self.cluster.guest}"
        self.cluster.guest += 1
        self.cluster.write_keys()
        self.cluster.processes["daemon"].send_signal(signal.SIGHUP)
        status = lambda key: Caller(self.cluster.port, key, self.caller.source).ask("GET", "/v1/scenes").status
        until = time.monotonic() + PATIENCE
        while status(f"guest-{self.cluster.guest}") != 200:
            if time.monotonic() > until:
                self.world.fault("wrong refusal", "a new key is refused two minutes after SIGHUP")
                return
            time.sleep(0.05)
        if (found := status(old)) != 401:
            self.world.fault("wrong refusal", f"a key that was removed gets {found}")

    def full_disk(self):
        self.world.begin(self.world.full_disks)
        until = time.monotonic() + self.chance.uniform(1, 4)
        refusals = 0
        while time.monotonic() < until:
            # What others delete leaves space.
            self.fillers += 1
            self.cluster.fill_disk(self.fillers)
            reply = self.soak.probe_upload(self.caller)
            refusals += reply.status == 507
            if reply.status not in (201, 202, 507) and not self.world.refused(reply):
                self.world.fault("wrong refusal", f"an upload on a full disk: {reply.brief()}")
        self.cluster.empty_disk()
        self.world.count("uploads refused by a full disk", refusals)
        until = time.monotonic() + PATIENCE
        while (reply := self.soak.probe_upload(self.caller)).status not in (201, 202):
            if time.monotonic() > until:
                self.world.fault("lost upload", f"uploads are refused two minutes after the disk has space again: {reply.brief()}")
                break
            time.sleep(0.1)
        self.world.finish(self.world.full_disks)

    def kill_daemon(self):
        self.soak.restart_daemon(signal.SIGKILL)

    def drain_daemon(self):
        self.soak.restart_daemon(signal.SIGTERM)

    def kill_all(self):
        """Everything at once, as when a machine loses its power."""
        others = ["broker", *self.cluster.workers]
        with self.ending_workers():
            for name in others:
                self.cluster.end(name, signal.SIGKILL)
        self.soak.restart_daemon(signal.SIGKILL, lambda: [self.cluster.start(name) for name in others])


class Memory:
    """Memory, open files and threads of each process, at equal points of the cycle. Growth is that of the memory which a process has for itself,
    as a share of all its resident memory: pages of files, such as the program's own, come and go as the system likes."""

    def __init__(self):
        self.series = {}

    def sample(self, cluster):
        for name, process in cluster.processes.items():
            if name in ("broker", "reference"):
                continue
            status = dict(line.split(":", 1) for line in open(f"/proc/{process.pid}/status"))
            files = len(os.listdir(f"/proc/{process.pid}/fd"))
            kib = lambda *kinds: sum(int(status[kind].split()[0]) for kind in kinds)
            sample = (kib("RssAnon", "RssShmem"), kib("VmRSS"), files)
            self.series.setdefault((name, process.pid), []).append(sample)

    @staticmethod
    def growth(values, whole):
        """By how much the median of the last third is above that of the first, without the first fifth, as a share of the median of `whole`.
        `None` with too few samples."""
        values = values[-(-len(values) // 5):]
        if len(values) < 3:
            return None
        third = len(values) // 3
        return (statistics.median(values[-third:]) - statistics.median(values[:third])) / statistics.median(whole)

    def judge(self, fault):
        """Lines of the table. `fault` is called with the kind and a text for each process that grew."""
        lines = []
        for (name, pid), samples in self.series.items():
            kib, resident, files = zip(*samples)
            growth = self.growth(kib, resident)
            if growth is None:
                continue
            limit = FLAT if len(samples) >= ENOUGH else ROUGHLY_FLAT
            shown = " ".join(f"{value / 1024:.1f}" for value in kib[::-(-len(kib) // 24)])
            held = statistics.median(resident) / 1024
            lines.append((f"memory of {name} ({pid})", f"{100 * growth:+.2f} % of {held:.0f} MiB, {100 * limit:.0f} % allowed; its own MiB: {shown}"))
            lines.append((f"files of {name} ({pid})", " ".join(map(str, files))))
            if growth > limit:
                fault("growth", f"the memory of {name} grew by {100 * growth:.2f} % of {held:.0f} MiB: {shown} MiB")
            if len(samples) >= ENOUGH and self.growth(files, files) > 0.2:
                fault("growth", f"the open files of {name} grew: {files}")
        return lines
