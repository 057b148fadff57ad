// Requests to the daemon, and what it answers when it cannot do what was asked (application/problem+json).

let key = sessionStorage.getItem('pointillist-key') || '';

export const hasKey = () => key !== '';
export function useKey(text) {
  key = text.trim();
  sessionStorage.setItem('pointillist-key', key);
}
export const headers = () => key ? { Authorization: 'Bearer ' + key } : {};

// What a WebSocket offers: pages cannot set its headers, so a key goes as a subprotocol.
export const subprotocols = () => key ? ['pointillist', 'pointillist.key.' + key] : ['pointillist'];

export const NO_ANSWER = { title: 'The server does not answer', detail: 'Is the daemon still running?', status: 0 };

export function problemFrom(status, statusText, text, retryAfterSeconds) {
  let problem = {};
  try { problem = JSON.parse(text); } catch { /* a proxy's page, perhaps */ }
  const after = Number(retryAfterSeconds);
  return { title: statusText || 'error', ...(after > 0 ? { retry_after_ms: after * 1000 } : {}), ...problem, status };
}

// An answer that is fine, or a problem is thrown. An abort is thrown as it is.
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

// Worth another try by itself: nobody there, busy, loading, or stopping.
export const isPassing = problem => [0, 409, 429, 502, 503, 504].includes(problem.status);

export const sceneUrl = (id, rest = '') => `/v1/scenes/${encodeURIComponent(id)}${rest}`;

// A query as it stands in addresses here: commas are kept readable.
export const queryText = query => query.toString().replaceAll('%2C', ',');
