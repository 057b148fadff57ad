// Requests to the server, and its problems (application/problem+json).

let key = sessionStorage.getItem('pointillist-key') || '';

export const hasKey = () => key !== '';
export function useKey(text) {
  key = text.trim();
  sessionStorage.setItem('pointillist-key', key);
}
export const headers = () => key ? { Authorization: 'Bearer ' + key } : {};

// Subprotocols of a WebSocket. Pages cannot set its headers, so the key goes as a subprotocol.
export const subprotocols = () => key ? ['pointillist', 'pointillist.key.' + key] : ['pointillist'];

export const NO_ANSWER = { title: 'The server does not answer', detail: 'Is `pointillist serve` still running?', status: 0 };

export function problemFrom(status, statusText, text, retryAfterSeconds) {
  let problem = {};
  try { problem = JSON.parse(text); } catch { /* a proxy's page, perhaps */ }
  const after = Number(retryAfterSeconds);
  return { title: statusText || 'error', ...(after > 0 ? { retry_after_ms: after * 1000 } : {}), ...problem, status };
}

// Returns a successful answer, and throws a problem for any other. An abort is thrown unchanged.
export async function reach(url, options = {}) {
  let response;
  try {
    response = await fetch(url, { ...options, headers: { ...headers(), ...options.headers } });
  } catch (error) {
    throw error.name === 'AbortError' ? error : NO_ANSWER;
  }
  if (response.ok) return response;
  throw problemFrom(response.status, response.statusText, await response.text(), response.headers.get('Retry-After'));
}

export const getJson = async (url, options) => (await reach(url, options)).json();

// Whether another try may succeed by itself: no answer, busy, loading, or stopping.
export const isPassing = problem => [0, 409, 429, 502, 503, 504].includes(problem.status);

export const sceneUrl = (id, rest = '') => `/v1/scenes/${encodeURIComponent(id)}${rest}`;

// Formats a query for an address. Commas stay readable.
export const queryText = query => query.toString().replaceAll('%2C', ',');
