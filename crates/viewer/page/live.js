// Robots as they publish: a WebSocket that is opened again when it closes.

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 10000;

export function followLive(onUpdate, onConnection) {
  let pause = FIRST_PAUSE_MS;
  const open = () => {
    const url = new URL("api/live", location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    const socket = new WebSocket(url);
    socket.onopen = () => {
      pause = FIRST_PAUSE_MS;
      onConnection(true);
    };
    socket.onmessage = (message) => onUpdate(JSON.parse(message.data));
    socket.onclose = () => {
      onConnection(false);
      setTimeout(open, pause);
      pause = Math.min(2 * pause, LONGEST_PAUSE_MS);
    };
  };
  open();
}
