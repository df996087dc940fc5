// Somebody else's server of OSCQuery (the npm package oscquery) in a VRChat's place, on this machine's loopback alone: "up" on stdout once it is told of.
// SIGUSR2: another avatar.
// Usage: node oscquery-server.mjs NODE_MODULES NAME OSC_PORT
import { createSocket } from 'node:dgram';
import { createServer } from 'node:net';
import { createRequire } from 'node:module';

const [packages, serviceName, oscPort] = process.argv.slice(2);
const require = createRequire(`${packages}/oscquery/package.json`);

// Whether a datagram to multicast DNS's group comes back over loopback.
const group = '224.0.0.251';
const comes = await new Promise((resolve) => {
  const socket = createSocket({ type: 'udp4', reuseAddr: true });
  const end = (is) => { socket.close(); resolve(is); };
  socket.on('error', () => end(false));
  socket.bind(0, () => {
    try {
      socket.addMembership(group, '127.0.0.1');
      socket.setMulticastInterface('127.0.0.1');
      socket.send('here', socket.address().port, group);
    } catch {
      end(false);
      return;
    }
    const patience = setTimeout(() => end(false), 5000);
    socket.on('message', () => { clearTimeout(patience); end(true); });
  });
});
if (!comes) {
  console.log('no multicast');
  process.exit(0);
}

// On a machine with several networks the responder takes its own announcement for another's, and begins anew for ever: loopback is enough here.
const responder = require.resolve('@homebridge/ciao');
const ciao = require(responder);
require.cache[responder].exports = { ...ciao, getResponder: () => ciao.getResponder({ interface: 'lo' }) };
const { OSCQueryServer } = require('./dist/lib/osc_query_server.js');

const httpPort = await new Promise((resolve) => {
  const probe = createServer().listen(0, '127.0.0.1', () => {
    const { port } = probe.address();
    probe.close(() => resolve(port));
  });
});
const server = new OSCQueryServer({ httpPort, bindAddress: '127.0.0.1', serviceName, oscQueryHostName: serviceName,
  oscIp: '127.0.0.1', oscPort: Number(oscPort), oscTransport: 'UDP' });
const kReadWrite = 3;
const add = (path, type, value) => server.addMethod(path, { access: kReadWrite, arguments: [{ type, value }] });
add('/avatar/change', 's', 'avtr_1');
add('/avatar/parameters/v2/JawOpen', 'f', 0);
for (const end of ['1', '2', 'Negative']) {
  add(`/avatar/parameters/FT/v2/JawOpen${end}`, 'T', false);
}
add('/avatar/parameters/EyeTrackingActive', 'T', false);
add('/avatar/parameters/VRCEmote', 'i', 0);
process.on('SIGUSR2', () => {
  for (const end of ['1', '2', 'Negative']) {
    server.removeMethod(`/avatar/parameters/FT/v2/JawOpen${end}`);
  }
  server.removeMethod('/avatar/parameters/EyeTrackingActive');
  add('/avatar/change', 's', 'avtr_2');
});
await server.start();
console.log('up');
