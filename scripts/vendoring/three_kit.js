// What the viewer's page takes from three.js: scripts/vendor_three makes one file of it.
export {
  WebGLRenderer, WebGLRenderTarget, Scene, Camera, PerspectiveCamera, OrthographicCamera,
  Object3D, Group, Mesh, LineSegments, Line, Points,
  BufferGeometry, BufferAttribute, PlaneGeometry,
  Uint8BufferAttribute, Uint16BufferAttribute, Uint32BufferAttribute, Float32BufferAttribute,
  ShaderMaterial, RawShaderMaterial, MeshBasicMaterial, LineBasicMaterial,
  Texture, DataTexture, DataArrayTexture, DepthTexture,
  Vector2, Vector3, Vector4, Matrix3, Matrix4, Quaternion, Euler, Spherical, Box3, Sphere, Color, Ray, Raycaster, Plane,
  MathUtils, DataUtils, ColorManagement,
  REVISION, GLSL3,
  FrontSide, BackSide, DoubleSide,
  NoBlending, NormalBlending, AdditiveBlending, CustomBlending,
  AddEquation, OneFactor, ZeroFactor, SrcAlphaFactor, OneMinusSrcAlphaFactor,
  LessDepth, LessEqualDepth, AlwaysDepth, EqualDepth, GreaterEqualDepth,
  NoToneMapping, NoColorSpace, SRGBColorSpace, LinearSRGBColorSpace,
  RepeatWrapping, ClampToEdgeWrapping, MirroredRepeatWrapping,
  NearestFilter, LinearFilter, NearestMipmapNearestFilter, LinearMipmapLinearFilter,
  UnsignedByteType, UnsignedShortType, UnsignedIntType, HalfFloatType, FloatType, IntType,
  RGBAFormat, RGBAIntegerFormat, RGFormat, RedFormat, RedIntegerFormat, DepthFormat, AlphaFormat,
  StaticDrawUsage, DynamicDrawUsage, MOUSE, TOUCH,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { EXRLoader } from "three/addons/loaders/EXRLoader.js";
