"""Checks the manifests of deploy/kubernetes without a cluster, alone and with the component films/, and that broken ones are refused.

    target/python/bin/python scripts/check-kubernetes.py [BINARY]

The schemas are those of Kubernetes, strict: unknown fields are refused. The other rules are about what schemas cannot say: names
that must exist, what every container has to have, and who may talk to whom. With the program's BINARY, environment variables are
held against its flags.
"""

import copy
import functools
import itertools
import json
import re
import subprocess
import sys
from pathlib import Path

import kubernetes_validate
import yaml

REPOSITORY = Path(__file__).resolve().parent.parent
BASE = REPOSITORY / "deploy/kubernetes"
FILMS = BASE / "films"
VERSIONS = ["1.29", "1.37"]
WORKLOADS = ("Deployment", "StatefulSet")
# Made by hand, since its content is secret: docs/kubernetes.md.
GIVEN_SECRETS = {"pointillist-api-keys", "pointillist-nats"}
# Who may open connections to whom, by the pods' label `component`. The balancer's policy names all pods that have the port `http`.
TALKS = {("balancer", "renderer"), ("balancer", "keeper"), ("balancer", "balancer"), ("balancer", "DNS")}
FILM_TALKS = {("keeper", "nats"), ("worker", "nats"), ("keeper", "DNS"), ("worker", "DNS")}
# A worker that stops finishes and stores the frames on the GPU, and answers to NATS take up to 5 s each.
WORKER_GRACE = 60
POINTILLIST_IMAGE = "pointillist:"


def read_kustomization(folder):
    return yaml.safe_load((folder / "kustomization.yaml").read_text())


def read_settings(file):
    lines = file.read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def apply_patch(document, operations):
    """Applies a JSON patch of the operations `test` and `add`, as kustomize does."""
    for operation in operations:
        *steps, last = operation["path"].strip("/").split("/")
        place = document
        for step in steps:
            place = place[int(step) if isinstance(place, list) else step]
        if operation["op"] == "add" and last == "-":
            place.append(operation["value"])
        elif operation["op"] == "add" and isinstance(place, dict) and last not in place:
            place[last] = operation["value"]
        elif operation["op"] != "test" or place[last] != operation["value"]:
            sys.exit(f"FAULT: the operation {operation} cannot be applied to {document['kind']} {document['metadata']['name']}")


def load(*folders):
    """Returns the documents of kustomizations, each with its file's name, and the settings of the ConfigMaps that they generate.

    Later folders are components, whose patches change documents of earlier ones.
    """
    documents, maps = [], {}
    for folder in folders:
        kustomization = read_kustomization(folder)
        for name in kustomization["resources"]:
            path = folder / name
            documents += [(str(path.relative_to(BASE)), document) for document in yaml.safe_load_all(path.read_text()) if document]
        for generated in kustomization["configMapGenerator"]:
            maps[generated["name"]] = {}
            for name in generated.get("envs", []):
                maps[generated["name"]] |= read_settings(folder / name)
        for patch in kustomization.get("patches", []):
            kind, name = patch["target"]["kind"], patch["target"]["name"]
            if all((kind, name) != (document["kind"], document["metadata"]["name"]) for _, document in documents):
                sys.exit(f"FAULT: {folder / patch['path']}: there is no {kind} {name}")
            apply_patch(of_kind(documents, kind, name), yaml.safe_load((folder / patch["path"]).read_text()))
    return documents, maps


def folder_faults(folder, kind):
    """Lists files that the kustomization of a folder misses or does not have."""
    kustomization = read_kustomization(folder)
    if kustomization["kind"] != kind:
        yield f"{folder.name}/kustomization.yaml: kind is {kustomization['kind']}, not {kind}"
    here = {path.name for path in folder.iterdir() if path.is_file()} - {"kustomization.yaml"}
    used = set(kustomization["resources"]) | {patch["path"] for patch in kustomization.get("patches", [])}
    for generated in kustomization["configMapGenerator"]:
        used |= set(generated.get("envs", []) + generated.get("files", []))
    for name in sorted(here ^ used):
        yield f"{folder.name}/kustomization.yaml and the folder differ in {name}"


@functools.cache
def schema_faults(name, text):
    """Lists what the schemas refuse in a document, which is given as JSON so that equal documents are validated once."""
    document, found = json.loads(text), []
    for version in VERSIONS:
        try:
            kubernetes_validate.validate(document, version, strict=True)
        except kubernetes_validate.ValidationError as error:
            place = ".".join(str(step) for step in error.absolute_path)
            found.append(f"{name}: {document.get('kind')}: {place}: {error.message[:200]} (Kubernetes {version})")
        except kubernetes_validate.SchemaNotFoundError as error:
            found.append(f"{name}: {error.message}")
    return found


def matches(selector, labels):
    for key, value in selector.get("matchLabels", {}).items():
        if labels.get(key) != value:
            return False
    return all(
        rule["operator"] == "In" and labels.get(rule["key"]) in rule["values"]
        for rule in selector.get("matchExpressions", [])
    )


def container_faults(where, pod, container):
    security = container.get("securityContext", {})
    ports = {port["name"] for port in container.get("ports", [])}
    if pod.get("securityContext", {}).get("runAsNonRoot") is not True:
        yield f"{where}: runs as root: set runAsNonRoot: true"
    for key, wanted in (("readOnlyRootFilesystem", True), ("allowPrivilegeEscalation", False)):
        if security.get(key) is not wanted:
            yield f"{where}: securityContext.{key} is not {str(wanted).lower()}"
    if security.get("capabilities", {}).get("drop") != ["ALL"]:
        yield f"{where}: keeps capabilities: drop [ALL]"
    for kind in ("requests", "limits"):
        for resource in ("cpu", "memory"):
            if resource not in container.get("resources", {}).get(kind, {}):
                yield f"{where}: resources.{kind}.{resource} is missing"
    for probe in ("livenessProbe", "readinessProbe"):
        if "httpGet" not in container.get(probe, {}) and not is_worker(container):
            yield f"{where}: {probe} is missing"
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        port = container.get(probe, {}).get("httpGet", {}).get("port")
        if port is not None and port not in ports:
            yield f"{where}: {probe} asks port {port!r}; the container has {sorted(ports)}"
    if not re.search(r":[\w.-]*\d", container["image"]):
        yield f"{where}: image {container['image']} names no release"
    volumes = {volume["name"] for volume in pod.get("volumes", [])}
    for mount in container.get("volumeMounts", []):
        if mount["name"] not in volumes:
            yield f"{where}: volumeMounts names {mount['name']!r}; the pod has {sorted(volumes)}"


def is_worker(container):
    return container.get("args") == ["worker"]


def variables(container, maps):
    """Returns the environment of a container."""
    found = {}
    for source in container.get("envFrom", []):
        found |= maps.get(source["configMapRef"]["name"], {})
    return found | {variable["name"]: variable.get("value", "") for variable in container.get("env", [])}


def variable_faults(where, container, maps):
    known = set()
    for source in container.get("envFrom", []):
        name = source["configMapRef"]["name"]
        if name not in maps:
            yield f"{where}: there is no ConfigMap {name}"
        known |= maps.get(name, {}).keys()
    for variable in container.get("env", []):
        secret = variable.get("valueFrom", {}).get("secretKeyRef", {}).get("name")
        if secret is not None and secret not in GIVEN_SECRETS:
            yield f"{where}: nobody makes the Secret {secret}"
        for reference in references(variable):
            # Kubernetes leaves such a reference as it stands.
            if reference not in known:
                yield f"{where}: {variable['name']} uses $({reference}), which no variable above it sets"
        known.add(variable["name"])


def references(variable):
    return re.findall(r"\$\((\w+)\)", variable.get("value", ""))


def program_faults(where, container, settings, flags, grace):
    """Lists faults of `pointillist serve` and `pointillist worker`."""
    command = container["args"][0]
    used = {reference for variable in container.get("env", []) for reference in references(variable)}
    for name in sorted(settings.keys() - used):
        if flags is not None and name not in flags[command]:
            yield f"{where}: {name} is no setting of `pointillist {command}`"
    for name, other in itertools.permutations(("POINTILLIST_NATS", "POINTILLIST_STORE")):
        if name not in settings and (other in settings or command == "worker"):
            yield f"{where}: {name} is missing"
    store = settings.get("POINTILLIST_STORE", "")
    if store.startswith("/") and store not in {mount["mountPath"] for mount in container["volumeMounts"]}:
        yield f"{where}: POINTILLIST_STORE={store} is no mounted volume"
    yield from worker_faults(where, container, grace) if command == "worker" else daemon_faults(where, container, settings, grace)


def daemon_faults(where, container, settings, grace):
    """A daemon is not ready while it loads or drains, and alive all the same."""
    wanted = {"startupProbe": "/healthz", "livenessProbe": "/healthz", "readinessProbe": "/readyz"}
    for probe, path in wanted.items():
        asked = container.get(probe, {}).get("httpGet", {}).get("path")
        if asked != path:
            yield f"{where}: {probe} asks {asked}, not {path}"
    least = int(settings.get("POINTILLIST_DRAIN_DELAY", 0)) + 2 * int(settings.get("POINTILLIST_DRAIN_SECONDS", 20)) + 1
    if grace < least:
        yield f"{where}: terminationGracePeriodSeconds {grace} ends a drain, which takes up to {least} s"


def worker_faults(where, container, grace):
    """A worker listens on no port. It is judged by its exit."""
    for name in ("ports", "startupProbe", "livenessProbe", "readinessProbe"):
        if name in container:
            yield f"{where}: {name} of a worker, which listens on no port and is judged by its exit"
    if grace < WORKER_GRACE:
        yield f"{where}: terminationGracePeriodSeconds {grace} ends a worker that finishes frames, which may take {WORKER_GRACE} s"


def lets(policies, way, labels, peer, ports):
    """Whether policies let pods with `labels` talk to a peer (`way` is Egress) or a peer to them (Ingress), on one of `ports`."""
    chosen = [spec for spec in policies if way in spec.get("policyTypes", []) and matches(spec["podSelector"], labels)]
    for rule in (rule for spec in chosen for rule in spec.get(way.lower(), [])):
        peers = rule.get("to" if way == "Egress" else "from", [{"namespaceSelector": {}}])
        # DNS and Prometheus are in namespaces of their own, which only a namespaceSelector names. A range of addresses may hold any pod.
        named = any(
            "ipBlock" in entry
            or entry.get("namespaceSelector") == {}
            or ("podSelector" in entry and matches(entry["podSelector"], peer))
            for entry in peers
        )
        if named and ("ports" not in rule or any(port.get("port") in ports for port in rule["ports"])):
            return True
    return not chosen


def talk_faults(documents, pods):
    """Compares what the network policies let happen with TALKS."""
    policies = [document["spec"] for _, document in documents if document["kind"] == "NetworkPolicy"]
    component = "app.kubernetes.io/component"
    ends = {labels[component]: (labels, {port["name"] for one in pod["containers"] for port in one.get("ports", [])}) for _, labels, pod, _ in pods}
    talks = TALKS | FILM_TALKS if "nats" in ends else TALKS
    everybody = {**ends, "DNS": ({}, {53})}
    for (source, (from_labels, _)), (target, (to_labels, ports)) in itertools.product(ends.items(), everybody.items()):
        wanted = (source, target) in talks
        words = f"network policies: {source} {'has to' if wanted else 'must not'} reach {target}"
        if lets(policies, "Egress", from_labels, to_labels, ports) != wanted:
            yield f"{words}: egress of {source}"
        # Clients reach the balancer from anywhere.
        if target not in ("balancer", "DNS") and lets(policies, "Ingress", to_labels, from_labels, ports) != wanted:
            yield f"{words}: ingress of {target}"


@functools.cache
def adapter_rules():
    """Returns the series of the rules for prometheus-adapter in docs/kubernetes.md, by the kind of metric."""
    blocks = re.findall(r"```yaml\n(.*?)```", (REPOSITORY / "docs/kubernetes.md").read_text(), re.S)
    found = {"Pods": [], "External": []}
    for block in map(yaml.safe_load, blocks):
        found["Pods"] += [rule["seriesQuery"] for rule in block.get("rules", [])]
        found["External"] += [rule["seriesQuery"] for rule in block.get("externalRules", [])]
    return found


def faults(documents, maps, flags=None):
    """Lists what is wrong."""
    found = []
    for name, document in documents:
        found += schema_faults(name, json.dumps(document))
    if found:
        # The other rules rely on the schemas.
        return found
    named = {(document["kind"], document["metadata"]["name"]) for _, document in documents}
    if len(named) != len(documents):
        found.append("two resources have the same kind and name")
    claims = {name for kind, name in named if kind == "PersistentVolumeClaim"}
    pods, shared = [], {}
    for name, document in documents:
        if document["kind"] not in WORKLOADS:
            continue
        spec = document["spec"]
        template = spec["template"]
        labels, pod = template["metadata"]["labels"], template["spec"]
        where = f"{name}: {document['kind']} {document['metadata']['name']}"
        pods.append((where, labels, pod, document))
        if not matches(spec["selector"], labels):
            found.append(f"{where}: its selector does not match its own pods")
        if document["kind"] == "StatefulSet" and ("Service", spec["serviceName"]) not in named:
            found.append(f"{where}: there is no Service {spec['serviceName']}")
        templates = {claim["metadata"]["name"] for claim in spec.get("volumeClaimTemplates", [])}
        for volume in pod.get("volumes", []):
            claim = volume.get("persistentVolumeClaim", {}).get("claimName")
            if claim is not None and claim not in claims:
                found.append(f"{where}: there is no PersistentVolumeClaim {claim}")
            if "configMap" in volume and volume["configMap"]["name"] not in maps:
                found.append(f"{where}: there is no ConfigMap {volume['configMap']['name']}")
            if "secret" in volume and volume["secret"]["secretName"] not in GIVEN_SECRETS:
                found.append(f"{where}: nobody makes the Secret {volume['secret']['secretName']}")
        mounted = {**pod, "volumes": pod.get("volumes", []) + [{"name": claim} for claim in templates]}
        grace = pod.get("terminationGracePeriodSeconds", 30)
        for container in pod["containers"]:
            here = f"{where}: container {container['name']}"
            found += container_faults(here, mounted, container)
            found += variable_faults(here, container, maps)
            if container["image"].startswith(POINTILLIST_IMAGE):
                settings = variables(container, maps)
                found += program_faults(here, container, settings, flags, grace)
                for name in {"POINTILLIST_NATS", "POINTILLIST_STORE"} & settings.keys():
                    shared.setdefault(name, set()).add(settings[name])
    for name, values in sorted(shared.items()):
        if len(values) > 1:
            found.append(f"the keeper and the workers differ in {name}: {sorted(values)}")
    found += talk_faults(documents, pods)
    for name, document in documents:
        kind, spec = document["kind"], document["spec"]
        where = f"{name}: {kind} {document['metadata']['name']}"
        selector = {"Service": {"matchLabels": spec.get("selector", {})}, "PodDisruptionBudget": spec.get("selector"), "NetworkPolicy": spec.get("podSelector")}.get(kind)
        if selector is not None:
            chosen = [pod for _, labels, pod, _ in pods if matches(selector, labels)]
            if not chosen:
                found.append(f"{where}: selects no pod")
            ports = {port["name"] for pod in chosen for container in pod["containers"] for port in container.get("ports", [])}
            asked = [port["targetPort"] for port in spec.get("ports", [])] if kind == "Service" else [
                port["port"] for rule in spec.get("ingress", []) for port in rule.get("ports", [])]
            for port in asked:
                if port not in ports:
                    found.append(f"{where}: port {port!r} is none of {sorted(ports)}")
        if kind == "HorizontalPodAutoscaler":
            target = spec["scaleTargetRef"]
            if (target["kind"], target["name"]) not in named:
                found.append(f"{where}: there is no {target['kind']} {target['name']}")
            for _, _, _, workload in pods:
                if workload["metadata"]["name"] == target["name"] and "replicas" in workload["spec"]:
                    found.append(f"{where}: `replicas` of its target would undo what it does at every apply")
            for metric in spec["metrics"]:
                wanted = metric[metric["type"].lower()]["metric"]["name"]
                if not any(re.match(rf"{wanted}\b", series) for series in adapter_rules()[metric["type"]]):
                    found.append(f"{where}: docs/kubernetes.md has no rule for the {metric['type']} metric {wanted}")
    return found


def collector_faults():
    """Lists what is wrong with the commented rules of network.yaml for a collector, which replace `egress: []`."""
    text = (BASE / "network.yaml").read_text()
    begun = re.search(r"^  egress: \[\]\n((?:  # .*\n)+)", text, re.M)
    if begun is None:
        return ["network.yaml: there are no commented rules after `egress: []`"]
    rules = re.sub(r"^  # ", "  ", begun[1], flags=re.M)
    policy = next(yaml.safe_load_all(text[: begun.start()] + rules + text[begun.end() :]))
    found = schema_faults("network.yaml with a collector", json.dumps(policy))
    labels = {"app.kubernetes.io/name": "pointillist", "app.kubernetes.io/component": "renderer"}
    if not found and not lets([policy["spec"]], "Egress", labels, {}, {53}):
        found.append("network.yaml with a collector: renderer has to reach DNS")
    if not found and all(port["port"] != 4318 for rule in policy["spec"]["egress"] for port in rule["ports"]):
        found.append("network.yaml with a collector: no rule has its port, 4318")
    return found


def flags_of(binary, command):
    """Returns the environment variables that a command reads."""
    text = subprocess.run([binary, command, "--help"], check=True, capture_output=True, text=True).stdout
    return set(re.findall(r"\[env: (POINTILLIST_\w+)=", text))


def of_kind(documents, kind, name=None):
    return next(document for _, document in documents if document["kind"] == kind and name in (None, document["metadata"]["name"]))


def pod_of(documents, kind="Deployment", name="pointillist"):
    return of_kind(documents, kind, name)["spec"]["template"]["spec"]


def container_of(documents, kind="Deployment", name="pointillist"):
    return pod_of(documents, kind, name)["containers"][0]


def worker_of(documents):
    return container_of(documents, name="pointillist-workers")


def keeper_of(documents):
    return container_of(documents, "StatefulSet", "pointillist-keeper")


def policy_of(documents, name):
    return of_kind(documents, "NetworkPolicy", name)["spec"]


def break_budget(documents):
    of_kind(documents, "PodDisruptionBudget")["spec"]["selector"]["matchLabels"]["app.kubernetes.io/component"] = "rendrer"


def break_root(documents):
    pod_of(documents)["securityContext"]["runAsNonRoot"] = False


# A way to break the manifests, and a part of what has to be said about it.
BREAKS = [
    (lambda d: container_of(d).update(imagePullPolcy="Always"), "imagePullPolcy"),
    (lambda d: container_of(d)["resources"]["limits"].pop("memory"), "resources.limits.memory is missing"),
    (lambda d: container_of(d)["readinessProbe"]["httpGet"].update(path="/healthz"), "not /readyz"),
    (lambda d: container_of(d)["livenessProbe"]["httpGet"].update(port="metric"), "asks port 'metric'"),
    (lambda d: container_of(d)["readinessProbe"].update(periodSeconds="often"), "periodSeconds"),
    (lambda d: container_of(d)["securityContext"].update(readOnlyRootFilesystem=False), "readOnlyRootFilesystem"),
    (lambda d: container_of(d)["securityContext"].pop("capabilities"), "keeps capabilities"),
    (lambda d: container_of(d).update(image="pointillist:latest"), "names no release"),
    (lambda d: container_of(d)["env"].append({"name": "POINTILLIST_QUUE", "value": "1"}), "POINTILLIST_QUUE is no setting"),
    (lambda d: container_of(d)["volumeMounts"].append({"name": "stat", "mountPath": "/x"}), "'stat'"),
    (lambda d: container_of(d)["envFrom"][0]["configMapRef"].update(name="pointilist"), "no ConfigMap pointilist"),
    (lambda d: of_kind(d, "Deployment", "pointillist")["spec"].update(replicas=2), "would undo"),
    (lambda d: pod_of(d).update(terminationGracePeriodSeconds=30), "ends a drain"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler")["spec"]["scaleTargetRef"].update(name="renderer"), "no Deployment renderer"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler").update(apiVersion="autoscaling/v2beta2"), "autoscaling/v2beta2"),
    (lambda d: of_kind(d, "Service", "pointillist")["spec"]["ports"][0].update(targetPort="web"), "port 'web'"),
    (lambda d: of_kind(d, "StatefulSet")["spec"].update(serviceName="keeper"), "no Service keeper"),
    (lambda d: of_kind(d, "PersistentVolumeClaim")["metadata"].update(name="scenes"), "no PersistentVolumeClaim pointillist-scenes"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler")["spec"]["metrics"][0]["pods"]["metric"].update(name="pointillist_queued"), "no rule for the Pods metric pointillist_queued"),
    (lambda d: policy_of(d, "pointillist-servers").pop("egress") or policy_of(d, "pointillist-servers").update(policyTypes=["Ingress"]), "renderer must not reach keeper: egress"),
    (lambda d: policy_of(d, "pointillist-balancer")["egress"].pop(), "balancer has to reach DNS"),
    (break_budget, "selects no pod"),
    (break_root, "runs as root"),
]


# Ways to break the manifests with films.
FILM_BREAKS = [
    (lambda d: worker_of(d).update(livenessProbe={"exec": {"command": ["true"]}}), "judged by its exit"),
    (lambda d: worker_of(d)["env"].append({"name": "POINTILLIST_LISTEN", "value": "0.0.0.0:8080"}), "POINTILLIST_LISTEN is no setting of `pointillist worker`"),
    (lambda d: worker_of(d)["env"].reverse(), "uses $(NATS_PASSWORD)"),
    (lambda d: worker_of(d)["env"].pop(), "POINTILLIST_NATS is missing"),
    (lambda d: worker_of(d)["env"][0]["valueFrom"]["secretKeyRef"].update(name="nats"), "nobody makes the Secret nats"),
    (lambda d: worker_of(d)["env"].append({"name": "POINTILLIST_STORE", "value": "/tmp"}), "differ in POINTILLIST_STORE"),
    (lambda d: worker_of(d)["volumeMounts"][0].update(mountPath="/stores"), "POINTILLIST_STORE=/store is no mounted volume"),
    (lambda d: worker_of(d).update(image="pointillist"), "names no release"),
    (lambda d: pod_of(d, name="pointillist-workers").update(terminationGracePeriodSeconds=30), "ends a worker that finishes frames"),
    (lambda d: pod_of(d, name="pointillist-workers")["securityContext"].pop("runAsNonRoot"), "runs as root"),
    (lambda d: keeper_of(d)["envFrom"].pop(), "POINTILLIST_STORE is missing"),
    (lambda d: keeper_of(d)["env"][1].update(value="nats://nats:4222"), "differ in POINTILLIST_NATS"),
    (lambda d: of_kind(d, "PersistentVolumeClaim", "pointillist-store")["metadata"].update(name="store"), "no PersistentVolumeClaim pointillist-store"),
    (lambda d: container_of(d, "StatefulSet", "pointillist-nats").update(image="nats:alpine"), "names no release"),
    (lambda d: container_of(d, "StatefulSet", "pointillist-nats").pop("readinessProbe"), "readinessProbe is missing"),
    (lambda d: container_of(d, "StatefulSet", "pointillist-nats")["securityContext"].update(readOnlyRootFilesystem=False), "readOnlyRootFilesystem"),
    (lambda d: of_kind(d, "Service", "pointillist-nats")["spec"]["ports"][0].update(targetPort="queue"), "port 'queue'"),
    (lambda d: of_kind(d, "Service", "pointillist-nats")["metadata"].update(name="nats"), "no Service pointillist-nats"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler", "pointillist-workers")["spec"]["scaleTargetRef"].update(name="workers"), "no Deployment workers"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler", "pointillist-workers")["spec"]["metrics"][0]["external"].pop("metric"), "'metric' is a required property"),
    (lambda d: of_kind(d, "Deployment", "pointillist-workers")["spec"].update(replicas=2), "would undo"),
    (lambda d: policy_of(d, "pointillist-films")["egress"].pop(), "worker has to reach DNS"),
    (lambda d: policy_of(d, "pointillist-films")["podSelector"]["matchExpressions"][0].update(values=["worker"]), "keeper has to reach nats: egress"),
    (lambda d: policy_of(d, "pointillist-films")["egress"][0]["ports"][0].update(port="natz"), "worker has to reach nats: egress"),
    (lambda d: policy_of(d, "pointillist-workers").update(ingress=[{}]), "balancer must not reach worker: ingress"),
    (lambda d: policy_of(d, "pointillist-nats")["ingress"][0].pop("from"), "renderer must not reach nats: ingress"),
    (lambda d: policy_of(d, "pointillist-nats")["ingress"][0]["from"].pop(), "has to reach nats"),
    (lambda d: policy_of(d, "pointillist-films")["egress"].append({"to": [{"ipBlock": {"cidr": "0.0.0.0/0"}}]}), "worker must not reach keeper: egress"),
    (lambda d: policy_of(d, "pointillist-nats").update(policyTypes=["Ingress"]), "nats must not reach DNS"),
]


def refused(breaks, documents, maps, flags, found):
    """Returns how many ways to break the documents were tried, and adds those that go unnoticed to `found`."""
    tried = 0
    for number, (damage, words) in enumerate(breaks):
        if flags is None and "is no setting" in words:
            continue
        broken = copy.deepcopy(documents)
        damage(broken)
        told = faults(broken, maps, flags)
        if not any(words in text for text in told):
            found.append(f"break {number} is not refused with {words!r}, but with {told}")
        tried += 1
    return tried


def main():
    flags = {command: flags_of(sys.argv[1], command) for command in ("serve", "worker")} if len(sys.argv) > 1 else None
    found = [*folder_faults(BASE, "Kustomization"), *folder_faults(FILMS, "Component")]
    base, base_maps = load(BASE)
    films, film_maps = load(BASE, FILMS)
    found += faults(base, base_maps, flags) + collector_faults()
    found += [f"with films: {text}" for text in faults(films, film_maps, flags)]
    tried = 0
    if not found:
        tried += refused(BREAKS, base, base_maps, flags, found)
        tried += refused(FILM_BREAKS, films, film_maps, flags, found)
    for text in found:
        print(f"FAULT: {text}")
    if not found:
        print(f"{len(base)} resources, and {len(films)} with films, hold for Kubernetes {' and '.join(VERSIONS)}; {tried} broken ones are refused")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
