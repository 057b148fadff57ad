"""Checks the manifests of deploy/kubernetes without a cluster, and that broken ones are refused.

    target/python/bin/python scripts/check-kubernetes.py [BINARY]

The schemas are those of Kubernetes, strict: unknown fields are refused. The other rules are about what schemas cannot say: names
that must exist, and what every container has to have. With the daemon's BINARY, environment variables are held against its flags.
"""

import copy
import re
import subprocess
import sys
from pathlib import Path

import kubernetes_validate
import yaml

FOLDER = Path(__file__).resolve().parent.parent / "deploy/kubernetes"
VERSIONS = ["1.29", "1.37"]
WORKLOADS = ("Deployment", "StatefulSet")
# Made by hand, since its content is secret: docs/kubernetes.md.
GIVEN_SECRETS = {"pointillist-api-keys"}


def load(folder):
    """Returns the kustomization and the documents of its resources, each with its file's name."""
    kustomization = yaml.safe_load((folder / "kustomization.yaml").read_text())
    documents = []
    for name in kustomization["resources"]:
        documents += [(name, document) for document in yaml.safe_load_all((folder / name).read_text()) if document]
    return kustomization, documents


def schema_faults(name, document):
    for version in VERSIONS:
        try:
            kubernetes_validate.validate(document, version, strict=True)
        except kubernetes_validate.ValidationError as error:
            place = ".".join(str(step) for step in error.absolute_path)
            yield f"{name}: {document.get('kind')}: {place}: {error.message[:200]} (Kubernetes {version})"
        except kubernetes_validate.SchemaNotFoundError as error:
            yield f"{name}: {error.message}"


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
        if "httpGet" not in container.get(probe, {}):
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


def daemon_faults(where, container, settings, flags):
    """A daemon is not ready while it loads or drains, and alive all the same."""
    paths = {probe: container.get(probe, {}).get("httpGet", {}).get("path") for probe in ("startupProbe", "livenessProbe", "readinessProbe")}
    wanted = {"startupProbe": "/healthz", "livenessProbe": "/healthz", "readinessProbe": "/readyz"}
    for probe, path in wanted.items():
        if paths[probe] != path:
            yield f"{where}: {probe} asks {paths[probe]}, not {path}"
    names = set(settings) | {variable["name"] for variable in container.get("env", [])}
    for name in sorted(names):
        if flags is not None and name not in flags:
            yield f"{where}: {name} is no setting of `pointillist serve`"


def faults(kustomization, documents, settings, flags=None):
    """Lists what is wrong."""
    found = []
    for name, document in documents:
        found += schema_faults(name, document)
    if found:
        # The other rules rely on the schemas.
        return found
    named = {(document["kind"], document["metadata"]["name"]) for _, document in documents}
    if len(named) != len(documents):
        found.append("two resources have the same kind and name")
    maps = {generated["name"] for generated in kustomization["configMapGenerator"]}
    claims = {name for kind, name in named if kind == "PersistentVolumeClaim"}
    pods = []
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
            for source in container.get("envFrom", []):
                if source["configMapRef"]["name"] not in maps:
                    found.append(f"{here}: there is no ConfigMap {source['configMapRef']['name']}")
            if container["name"] == "pointillist":
                found += daemon_faults(here, container, settings, flags)
                least = int(settings["POINTILLIST_DRAIN_DELAY"]) + 2 * int(settings["POINTILLIST_DRAIN_SECONDS"]) + 1
                if grace < least:
                    found.append(f"{where}: terminationGracePeriodSeconds {grace} ends a drain, which takes up to {least} s")
    for name, document in documents:
        kind, spec = document["kind"], document["spec"]
        where = f"{name}: {kind} {document['metadata']['name']}"
        selector = {"Service": {"matchLabels": spec.get("selector", {})}, "PodDisruptionBudget": spec.get("selector"), "NetworkPolicy": spec.get("podSelector")}.get(kind)
        if selector is not None:
            chosen = [pod for _, labels, pod, _ in pods if matches(selector, labels)]
            if not chosen:
                found.append(f"{where}: selects no pod")
            ports = {port["name"] for pod in chosen for container in pod["containers"] for port in container["ports"]}
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
    return found


def flags_of(binary):
    """Returns the environment variables that `pointillist serve` reads."""
    text = subprocess.run([binary, "serve", "--help"], check=True, capture_output=True, text=True).stdout
    return set(re.findall(r"\[env: (POINTILLIST_\w+)=", text))


def read_settings(folder):
    lines = (folder / "pointillist.env").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def of_kind(documents, kind, name=None):
    return next(document for _, document in documents if document["kind"] == kind and name in (None, document["metadata"]["name"]))


def container_of(documents):
    return of_kind(documents, "Deployment", "pointillist")["spec"]["template"]["spec"]["containers"][0]


def break_budget(documents):
    of_kind(documents, "PodDisruptionBudget")["spec"]["selector"]["matchLabels"]["app.kubernetes.io/component"] = "rendrer"


def break_root(documents):
    of_kind(documents, "Deployment", "pointillist")["spec"]["template"]["spec"]["securityContext"]["runAsNonRoot"] = False


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
    (lambda d: container_of(d)["env"].append({"name": "POINTILLIST_QUUE", "value": "1"}), "POINTILLIST_QUUE"),
    (lambda d: container_of(d)["volumeMounts"].append({"name": "stat", "mountPath": "/x"}), "'stat'"),
    (lambda d: container_of(d)["envFrom"][0]["configMapRef"].update(name="pointilist"), "no ConfigMap pointilist"),
    (lambda d: of_kind(d, "Deployment", "pointillist")["spec"].update(replicas=2), "would undo"),
    (lambda d: of_kind(d, "Deployment", "pointillist")["spec"]["template"]["spec"].update(terminationGracePeriodSeconds=30), "ends a drain"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler")["spec"]["scaleTargetRef"].update(name="renderer"), "no Deployment renderer"),
    (lambda d: of_kind(d, "HorizontalPodAutoscaler").update(apiVersion="autoscaling/v2beta2"), "autoscaling/v2beta2"),
    (lambda d: of_kind(d, "Service", "pointillist")["spec"]["ports"][0].update(targetPort="web"), "port 'web'"),
    (lambda d: of_kind(d, "StatefulSet")["spec"].update(serviceName="keeper"), "no Service keeper"),
    (lambda d: of_kind(d, "PersistentVolumeClaim")["metadata"].update(name="scenes"), "no PersistentVolumeClaim pointillist-scenes"),
    (break_budget, "selects no pod"),
    (break_root, "runs as root"),
]


def main():
    flags = flags_of(sys.argv[1]) if len(sys.argv) > 1 else None
    kustomization, documents = load(FOLDER)
    settings = read_settings(FOLDER)
    found = faults(kustomization, documents, settings, flags)
    here = {path.name for path in FOLDER.iterdir() if path.suffix in (".yaml", ".env", ".cfg")} - {"kustomization.yaml"}
    used = set(kustomization["resources"])
    for generated in kustomization["configMapGenerator"]:
        used |= set(generated.get("envs", []) + generated.get("files", []))
    found += [f"kustomization.yaml and the folder differ in {name}" for name in sorted(here ^ used)]
    refused = 0
    for number, (damage, words) in enumerate(BREAKS):
        if words.startswith("POINTILLIST_") and flags is None:
            continue
        broken = copy.deepcopy(documents)
        damage(broken)
        told = faults(kustomization, broken, settings, flags)
        if not any(words in text for text in told):
            found.append(f"break {number} is not refused with {words!r}, but with {told}")
        refused += 1
    for text in found:
        print(f"FAULT: {text}")
    if not found:
        print(f"{len(documents)} resources hold for Kubernetes {' and '.join(VERSIONS)}; {refused} broken ones are refused")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
