// Load for a Pointillist server with k6 (https://k6.io), for those whose load tests are in it already:
//
//   k6 run -e URL=http://127.0.0.1:8080 -e SCENE=town -e RATE=40 -e DURATION=30s deploy/k6.js
//
// An open loop: requests start at a constant rate, whatever became of earlier ones. One that finds no free VU is counted as
// `dropped_iterations` and is in no percentile, so that a threshold holds their number at 0. k6 counts a request from when its VU
// sends it; `pointillist load` counts from when it was due, searches for the knee and draws the curve.
//
// API_KEY is sent as a bearer key; QUERY holds further parameters of the frame, as in -e QUERY='lod=spt&reconstruct=splats'.

import http from 'k6/http';
import exec from 'k6/execution';
import { check } from 'k6';
import { Counter, Trend } from 'k6/metrics';

const BASE = (__ENV.URL || 'http://127.0.0.1:8080').replace(/\/+$/, '');
const SCENE = __ENV.SCENE || 'town';
const FRAME = `w=${__ENV.WIDTH || 640}&h=${__ENV.HEIGHT || 480}&format=${__ENV.FORMAT || 'jpeg'}`;
const QUERY = __ENV.QUERY ? `&${__ENV.QUERY}` : '';
const HEADERS = __ENV.API_KEY ? { Authorization: `Bearer ${__ENV.API_KEY}` } : {};
const FOV_DEG = 40;
// An irrational share of the way around, so that no pose comes twice.
const STEP = 0.6180339887498949 / 64;

const queueTime = new Trend('frame_queue_ms', true);
const gpuTime = new Trend('frame_gpu_ms', true);
const refused = new Counter('frames_refused');

export const options = {
  discardResponseBodies: true,
  scenarios: {
    frames: {
      executor: 'constant-arrival-rate',
      rate: Number(__ENV.RATE || 20),
      timeUnit: '1s',
      duration: __ENV.DURATION || '30s',
      preAllocatedVUs: Number(__ENV.VUS || 64),
      maxVUs: Number(__ENV.VUS || 64) * 4,
    },
  },
  thresholds: {
    checks: ['rate>0.95'],
    dropped_iterations: ['count==0'],
    http_req_duration: ['p(99)<1000'],
  },
};

// The scene's box becomes an orbit from which all of it is seen.
export function setup() {
  const answer = http.get(`${BASE}/v1/scenes/${encodeURIComponent(SCENE)}`, { headers: HEADERS, responseType: 'text' });
  const scene = answer.status === 200 ? answer.json() : {};
  if (!scene.bounds) {
    throw new Error(`scene ${SCENE}: ${answer.status} ${answer.body}`);
  }
  const [min, max] = scene.bounds;
  const half = min.map((low, axis) => (max[axis] - low) / 2);
  const radius = Math.hypot(...half) || 0.3;
  return {
    centre: min.map((low, axis) => low + half[axis]),
    distance: radius / Math.sin((FOV_DEG * Math.PI) / 360),
    // The axis that is up, and which way.
    up: scene.up.map(Math.abs).reduce((best, size, axis, all) => (size > all[best] ? axis : best), 0),
    sign: Math.sign(scene.up.reduce((best, value) => (Math.abs(value) > Math.abs(best) ? value : best), 0)) || 1,
  };
}

function pose(orbit, number) {
  const angle = 2 * Math.PI * ((number * STEP) % 1);
  const rise = (25 * Math.PI) / 180;
  const eye = orbit.centre.slice();
  eye[orbit.up] += orbit.sign * orbit.distance * Math.sin(rise);
  eye[(orbit.up + 1) % 3] += orbit.distance * Math.cos(rise) * Math.cos(angle);
  eye[(orbit.up + 2) % 3] += orbit.distance * Math.cos(rise) * Math.sin(angle);
  return `eye=${eye.join(',')}&target=${orbit.centre.join(',')}&fov=${FOV_DEG}`;
}

export default function (orbit) {
  const query = `${pose(orbit, exec.scenario.iterationInTest)}&${FRAME}${QUERY}`;
  // One name for all poses: each address as a series of its own would fill memory.
  const answer = http.get(`${BASE}/v1/scenes/${encodeURIComponent(SCENE)}/frame?${query}`, {
    headers: HEADERS,
    tags: { name: 'frame' },
  });
  check(answer, { 'a frame': (r) => r.status === 200 });
  if (answer.status === 429 || answer.status === 503) {
    refused.add(1);
  }
  const receipt = answer.headers['Pointillist-Receipt'];
  if (receipt) {
    const { gpu_ns, views, queue_ns } = JSON.parse(receipt);
    queueTime.add(queue_ns / 1e6);
    if (gpu_ns !== null) {
      gpuTime.add(gpu_ns / 1e6 / views);
    }
  }
}
