// VTube Studio's API for plug-ins as its maker publishes it (https://github.com/DenchiSoft/VTubeStudio), on somebody else's WebSockets: it says on stdout
// what it was asked, a line of JSON each, and refuses what the published page does not allow.
// Usage: node vts-server.mjs PLAYWRIGHT_CORE_FOLDER SCENARIO PORT      PORT 0: any; the first line says which
import { createRequire } from 'node:module';

const [folder, scenario, port] = process.argv.slice(2);
const { wsServer } = createRequire(import.meta.url)(`${folder}/lib/utilsBundle.js`);
const say = (line) => console.log(JSON.stringify(line));
const kOwn = ['FacePositionX', 'FacePositionY', 'FacePositionZ', 'FaceAngleX', 'FaceAngleY', 'FaceAngleZ', 'MouthSmile', 'MouthOpen', 'Brows', 'TongueOut',
  'EyeOpenLeft', 'EyeOpenRight', 'EyeLeftX', 'EyeLeftY', 'EyeRightX', 'EyeRightY', 'CheekPuff', 'FaceAngry', 'BrowLeftY', 'BrowRightY', 'MouthX'];
const known = new Set(kOwn);
const tokens = new Set(scenario === 'revoked' ? [] : ['token-1']);
let given = scenario === 'revoked' ? 2 : 1;

const server = new wsServer({ port: Number(port), host: '127.0.0.1' });
server.on('listening', () => say({ port: server.address().port }));
server.on('connection', (socket) => {
  let authenticated = false;
  let injected = 0;
  socket.on('message', (bytes, isBinary) => {
    const request = JSON.parse(bytes.toString());
    const { messageType, requestID, data } = request;
    const answer = (type, content) => socket.send(JSON.stringify({
      apiName: 'VTubeStudioPublicAPI', apiVersion: '1.0', timestamp: Date.now(), messageType: type, requestID, data: content }));
    const refuse = (errorID, message) => answer('APIError', { errorID, message });
    if (isBinary || request.apiName !== 'VTubeStudioPublicAPI' || request.apiVersion !== '1.0' || !/^[\x21-\x7e]{1,64}$/.test(requestID)) {
      say({ fault: request });
      return refuse(2, 'not as published');
    }
    if (scenario === 'garbage') {
      return socket.send('}{');
    }
    if (messageType === 'AuthenticationTokenRequest') {
      say({ asked: data });
      if (scenario === 'deny') {
        return refuse(50, 'User has denied API access for your plugin.');
      }
      const token = `token-${given}`;
      tokens.add(token);
      return answer('AuthenticationTokenResponse', { authenticationToken: token });
    }
    if (messageType === 'AuthenticationRequest') {
      say({ shown: data.authenticationToken });
      if (scenario === 'silent') {
        return undefined;
      }
      authenticated = tokens.has(data.authenticationToken) && data.pluginName.length >= 3 && data.pluginDeveloper.length >= 3;
      return answer('AuthenticationResponse', { authenticated, reason: authenticated ? 'Token valid.' : 'Token invalid or revoked.' });
    }
    if (!authenticated) {
      return refuse(8, 'This request requires authentication.');
    }
    if (messageType === 'ParameterCreationRequest') {
      say({ created: data });
      if (!/^[A-Za-z0-9]{4,32}$/.test(data.parameterName) || data.parameterName === 'Refused') {
        return refuse(350, 'Custom parameter name invalid.');
      }
      known.add(data.parameterName);
      return data.parameterName === 'OfAnother' ? refuse(352, 'Created by another plugin.') : answer('ParameterCreationResponse', { parameterName: data.parameterName });
    }
    if (messageType === 'InjectParameterDataRequest') {
      const wrong = data.parameterValues.find(({ id, value }) => !known.has(id) || !Number.isFinite(value) || Math.abs(value) > 1e6);
      say({ injected: Object.fromEntries(data.parameterValues.map(({ id, value }) => [id, value])), faceFound: data.faceFound, wrong });
      injected += 1;
      if (scenario === 'revoke' && injected === 2) {
        authenticated = false;
      }
      return wrong ? refuse(453, `Parameter ${wrong.id} not found.`) : answer('InjectParameterDataResponse', {});
    }
    say({ fault: request });
    return refuse(7, 'Unknown request.');
  });
});
