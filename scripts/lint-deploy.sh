#!/usr/bin/env bash
# Checks the files of deploy/ with whatever checkers this machine has, and says which it lacks.
# Exit status 1 when one of them finds a fault.
#
#   scripts/lint-deploy.sh [BINARY]    with the binary, the configuration's keys are held against its flags
set -uo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
binary=${1:-}
# Programs that scripts/setup-servers.sh and scripts/setup-nats.sh unpacked.
PATH=$PWD/target/servers/bin:$PATH:/usr/sbin:$PWD/target/nats/usr/sbin
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
faults=0

ok() { printf 'ok: %s\n' "$*"; }
lacking() { printf '!! not checked: %s\n' "$*"; }
fault() {
    printf 'FAULT: %s\n' "$*"
    faults=$((faults + 1))
}
have() { command -v "$1" >/dev/null 2>&1; }
# Runs a checker; shows what it says only when it finds something.
checked() { # NAME COMMAND…
    local name=$1
    shift
    if "$@" >"$work/said" 2>&1; then
        ok "$name"
    else
        cat "$work/said"
        fault "$name"
    fi
}

# --- Dockerfile: every file it copies exists, base images are pinned to a release, it does not run as root
if have docker && docker buildx version >/dev/null 2>&1 && docker info >/dev/null 2>&1; then
    checked "Dockerfile (docker build --check)" docker build --check -f deploy/Dockerfile .
else
    lacking "Dockerfile with 'docker build --check' (no Docker daemon with buildx)"
fi
dockerfile_rules() {
    local bad=0 source
    if grep -E '^FROM [^ ]+(:latest)?( AS|$)' deploy/Dockerfile | grep -Ev '^FROM [^ ]+:[^ ]+' >&2; then
        echo "a base image without a release" >&2
        bad=1
    fi
    grep -q '^USER [1-9]' deploy/Dockerfile || { echo "runs as root" >&2; bad=1; }
    grep -q '^HEALTHCHECK' deploy/Dockerfile || { echo "no health check" >&2; bad=1; }
    while read -r source; do
        [ -e "$source" ] || { echo "COPY $source: not in the repository" >&2; bad=1; }
    done < <(sed -nE 's/^COPY (--chown=[^ ]+ )?([^- ][^ ]*) .*/\2/p' deploy/Dockerfile)
    return "$bad"
}
checked "Dockerfile (own rules)" dockerfile_rules

# --- YAML
yaml_parses() {
    local file
    for file in deploy/*.yaml deploy/kubernetes/*.yaml deploy/kubernetes/films/*.yaml; do
        python3 -c 'import sys, yaml; list(yaml.safe_load_all(open(sys.argv[1])))' "$file" || return 1
    done
}
if have docker && docker compose version >/dev/null 2>&1; then
    checked "compose.yaml (docker compose config)" docker compose -f deploy/compose.yaml config --quiet
    checked "compose.films.yaml (docker compose config)" \
        docker compose -f deploy/compose.yaml -f deploy/compose.films.yaml config --quiet
elif have python3 && python3 -c 'import yaml' 2>/dev/null; then
    checked "YAML parses" yaml_parses
else
    lacking "compose.yaml (neither docker compose nor Python's yaml)"
fi

# --- systemd
if have systemd-analyze; then
    # A unit as it will be, but with a program that exists here; with a second name, that file is a drop-in.
    check_unit() { # UNIT [DROP-IN]
        local name=$1${2:+ with $2} unit=$work/units${2:+-with}/$1
        mkdir -p "${unit%/*}" ${2:+"$unit.d"}
        sed "s|/usr/local/bin/pointillist|$(command -v true)|; /^Documentation=/d" "deploy/$1" >"$unit"
        [ -z "${2:-}" ] || cp "deploy/$2" "$unit.d/"
        verify_unit() { systemd-analyze verify "$unit" 2>&1 | tee /dev/stderr | { ! grep -q pointillist; }; }
        checked "$name (systemd-analyze verify)" verify_unit
        # Exposure from 0 (safe) to 10; ours stays in the class that systemd calls OK.
        if systemd-analyze security --offline=true --threshold=25 "$unit" >"$work/exposure" 2>&1; then
            ok "$name:$(sed -n 's/.*\(Overall exposure level\)[^:]*:/ \1/p' "$work/exposure")"
        elif grep -q 'Overall exposure' "$work/exposure"; then
            fault "$name:$(sed -n 's/.*\(Overall exposure level\)/ \1/p' "$work/exposure")"
        else
            lacking "$name: exposure (systemd-analyze is too old for --offline)"
        fi
    }
    check_unit pointillist.service
    check_unit pointillist.service pointillist-cluster.conf
    check_unit pointillist-worker.service
else
    lacking "systemd units (no systemd-analyze)"
fi

# --- proxies; names of other containers resolve only where those run
if have nginx; then
    mkdir -p "$work/cache"
    sed "s|server pointillist:8080|server 127.0.0.1:8080|; s|/var/cache/nginx/pointillist|$work/cache|; s|listen 80|listen 18080|; s|::\]:80|::]:18080|" \
        deploy/nginx.conf >"$work/site.conf"
    {
        printf 'pid %s/pid;\nerror_log stderr;\nevents {}\nhttp {\n    access_log off;\n' "$work"
        for kind in client_body proxy fastcgi uwsgi scgi; do printf '    %s_temp_path %s/%s;\n' "$kind" "$work" "$kind"; done
        printf '    include %s/site.conf;\n}\n' "$work"
    } >"$work/nginx.conf"
    checked "nginx.conf (nginx -t)" nginx -t -e stderr -c "$work/nginx.conf"
    checked "nginx.conf (which server gets what)" scripts/check-routes.py nginx
else
    lacking "nginx.conf (no nginx)"
fi
if have haproxy; then
    # Warnings are faults, too; -q would hide them.
    quiet_haproxy() { haproxy -c -f "$1" 2>&1 | tee /dev/stderr | { ! grep -q WARNING; }; }
    checked "haproxy.cfg (haproxy -c)" quiet_haproxy deploy/haproxy.cfg
    # A cluster runs HAProxy 3; older ones do not know hash-key.
    sed 's/ hash-key addr-port//' deploy/kubernetes/haproxy.cfg >"$work/cluster.cfg"
    checked "kubernetes/haproxy.cfg (haproxy -c)" quiet_haproxy "$work/cluster.cfg"
    checked "haproxy.cfg and kubernetes/haproxy.cfg (which server gets what)" scripts/check-routes.py haproxy
else
    lacking "haproxy.cfg (no haproxy)"
fi

# --- Prometheus
if have promtool; then
    for rules in deploy/prometheus-rules.yaml deploy/prometheus-rules-films.yaml; do
        tests=${rules%.yaml}-test.yaml
        checked "${rules#deploy/} (promtool check rules)" promtool check rules "$rules"
        checked "${rules#deploy/} (promtool test rules)" promtool test rules "$tests"
        every_alert_is_tested() {
            local alert
            for alert in $(sed -n 's/.*- alert: //p' "$rules"); do
                grep -A1 "alertname: $alert$" "$tests" | grep -q exp_alerts ||
                    { echo "$alert: no test in which it fires" >&2; return 1; }
                grep -q "\`$alert\`" docs/deploy.md || { echo "$alert: docs/deploy.md does not say what to do" >&2; return 1; }
            done
        }
        checked "${rules#deploy/} (every alert fires in a test, and has advice)" every_alert_is_tested
    done
    # The queries of dashboards become rules, which promtool can read.
    queries_parse() {
        python3 - "$1" >"$work/queries.yaml" <<'QUERIES'
import json, sys
panels = json.load(open(sys.argv[1]))["panels"]
queries = [target["expr"].replace("$instance", ".*") for panel in panels for target in panel["targets"]]
rules = [{"record": f"query:{number}", "expr": query} for number, query in enumerate(queries)]
print(json.dumps({"groups": [{"name": "queries", "rules": rules}]}))
QUERIES
        promtool check rules "$work/queries.yaml"
    }
    for dashboard in deploy/grafana-dashboard*.json; do
        checked "${dashboard#deploy/} (queries, promtool check rules)" queries_parse "$dashboard"
    done
else
    lacking "prometheus-rules.yaml with 'promtool check rules' (no promtool; Debian's package prometheus has it)"
fi
# A server without workers does not have the metrics of films, so tests that ask a server do not know them: their names are looked up in
# the source.
film_metrics_exist() {
    local metric name bad=0
    for metric in $(grep -ohE 'pointillist_[a-z_]+' deploy/*-films*.yaml deploy/*-films*.json deploy/kubernetes/films/*.yaml | sort -u); do
        name=${metric#pointillist_}
        name=${name%_total}
        grep -rqF "\"$name\"" src || grep -rqF "\"${name%_bytes}\"" src || { echo "$metric: the server has no such metric" >&2; bad=1; }
    done
    return "$bad"
}
checked "metrics of films (exist)" film_metrics_exist

# --- Kubernetes
python=${POINTILLIST_PYTHON:-target/python/bin/python}
if [ -x "$python" ] && "$python" -c 'import kubernetes_validate' 2>/dev/null; then
    flags=()
    [ -x "$binary" ] && flags=("$binary")
    checked "kubernetes/ (schemas, and broken manifests)" "$python" scripts/check-kubernetes.py "${flags[@]}"
else
    lacking "kubernetes/ (no kubernetes-validate; scripts/setup-python.sh installs it)"
fi

# A password of digits is the one that an unquoted variable would spoil.
if have nats-server; then
    checked "kubernetes/films/nats.conf (nats-server -t)" \
        env QUOTED_PASSWORD='"12345678"' nats-server -t -c deploy/kubernetes/films/nats.conf
else
    lacking "kubernetes/films/nats.conf (no nats-server; scripts/setup-nats.sh installs it)"
fi

# --- k6: its own parser where it is there, and the script itself with k6's modules played by a few lines of node
if have k6; then
    checked "k6.js (k6 inspect)" k6 inspect deploy/k6.js
else
    lacking "k6.js with 'k6 inspect' (no k6)"
fi
k6_played() {
    {
        cat <<'PLAYED'
const __ENV = { URL: 'http://daemon/', SCENE: 'a scene', QUERY: 'lod=spt', API_KEY: 'k' };
const asked = [], added = [], exec = { scenario: { iterationInTest: 0 } };
class Metric { constructor(name) { this.name = name; } add(value) { added.push([this.name, value]); } }
const Counter = Metric, Trend = Metric;
const scene = { bounds: [[10, 20, -5], [14, 26, 7]], up: [0, 0, 1] };
const receipt = JSON.stringify({ gpu_ns: 4e6, views: 2, queue_ns: 1e6 });
const check = (answer, wanted) => Object.values(wanted).every((holds) => holds(answer));
const http = { get: (url, how) => {
    asked.push([url, how]);
    return url.includes('/frame?') ? { status: 503, headers: { 'Pointillist-Receipt': receipt } } : { status: 200, json: () => scene };
} };
PLAYED
        sed -E '/^import /d; s/^export default function/function iteration/; s/^export //' deploy/k6.js
        cat <<'PLAYED'
const fail = (what) => { throw new Error(`${what}: ${JSON.stringify(asked.slice(-3))} ${JSON.stringify(added)}`); };
const orbit = setup();
const seen = new Set();
for (; exec.scenario.iterationInTest < 5000; exec.scenario.iterationInTest++) {
    iteration(orbit);
    const [url, how] = asked[asked.length - 1];
    const query = new URL(url).searchParams;
    const [eye, target] = ['eye', 'target'].map((name) => query.get(name).split(',').map(Number));
    const distance = Math.hypot(...eye.map((at, axis) => at - target[axis]));
    // Half the diagonal of the box is 7; an eye that sees the sphere around it under 40 degrees is 7 / sin 20° away.
    if (Math.abs(distance - 7 / Math.sin(Math.PI / 9)) > 1e-6 || target.join() !== '12,23,1') fail('not an orbit');
    if (query.get('lod') !== 'spt' || how.headers.Authorization !== 'Bearer k' || how.tags.name !== 'frame') fail('not as asked');
    if (!url.startsWith('http://daemon/v1/scenes/a%20scene/frame?')) fail('not the address');
    seen.add(query.get('eye'));
}
if (seen.size !== 5000) fail('a pose came twice');
const [first, second, third] = added;
if (first[0] !== 'frames_refused' || second[1] !== 1 || third[1] !== 2) fail('not the measures');
if (options.scenarios.frames.executor !== 'constant-arrival-rate') fail('not an open loop');
PLAYED
    } >"$work/k6.mjs"
    node "$work/k6.mjs"
}
if have node; then
    checked "k6.js (played by node)" k6_played
else
    lacking "k6.js (no node)"
fi

# --- configuration: each key, given or commented out, is a flag of `serve`, and every flag is there
if [ -x "$binary" ] && "$binary" serve --help >"$work/help" 2>/dev/null; then
    # Explanations are indented deeper than flags, so that a flag named in one is not taken for one.
    sed -nE 's/^ {2,6}(-[a-z], )?--([a-z0-9-]+).*/\2/p' "$work/help" | grep -vxE 'config|help|version' | sort -u >"$work/flags"
    sed -nE 's/^(# )?([a-z0-9-]+) = .*/\2/p' deploy/pointillist.toml | sort -u >"$work/keys"
    if diff "$work/keys" "$work/flags" >"$work/difference"; then
        ok "pointillist.toml has every setting of 'serve' and no other"
    else
        cat "$work/difference"
        fault "pointillist.toml (<) and the flags of 'pointillist serve' (>) differ"
    fi
else
    lacking "pointillist.toml against the flags (no binary given)"
fi

if [ "$faults" -gt 0 ]; then
    echo "$faults fault(s) in deploy/"
    exit 1
fi
