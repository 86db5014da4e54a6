// Robots as they publish: a WebSocket that is opened again when it closes, or says nothing.

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 10000;
// The server says something twice a second.
const SILENCE_MS = 2000;
const LOOK_MS = 250;

// `onConnection(isConnected)`: whether the server tells how robots are.
export function followLive(onUpdate, onConnection) {
  let pause = FIRST_PAUSE_MS;
  const open = () => {
    const url = new URL("api/live", location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    const socket = new WebSocket(url);
    let heard = null;
    let isEnded = false;
    const end = () => {
      if (isEnded) return;
      isEnded = true;
      clearInterval(watch);
      onConnection(false);
      socket.close();
      setTimeout(open, pause);
      pause = Math.min(2 * pause, LONGEST_PAUSE_MS);
    };
    const watch = setInterval(() => heard !== null && performance.now() - heard > SILENCE_MS && end(), LOOK_MS);
    socket.onmessage = (message) => {
      if (isEnded) return;
      const isFirst = heard === null;
      heard = performance.now();
      pause = FIRST_PAUSE_MS;
      onUpdate(JSON.parse(message.data));
      if (isFirst) onConnection(true);
    };
    socket.onclose = end;
  };
  open();
}
