// As much of UnityEngine's shape as FacetFace.cs uses, so that a compiler reads it without Unity. Nothing of it runs.
namespace UnityEngine
{
    public struct Vector2 { public Vector2(float x, float y) { } }
    public struct Vector3 { public Vector3(float x, float y, float z) { } }
    public struct Color { public Color(float r, float g, float b, float a) { } }
    public struct Quaternion { public static Quaternion LookRotation(Vector3 forward, Vector3 up) { return new Quaternion(); } }
    public static class Mathf { public static float Clamp01(float value) { return value; } }
    namespace Rendering { public enum IndexFormat { UInt16, UInt32 } }
    public class Object { }
    public class Mesh : Object
    {
        public Rendering.IndexFormat indexFormat { get; set; }
        public Vector3[] vertices { get; set; }
        public Vector3[] normals { get; set; }
        public Vector2[] uv { get; set; }
        public Color[] colors { get; set; }
        public int[] triangles { get; set; }
        public int blendShapeCount { get { return 0; } }
        public string GetBlendShapeName(int k) { return ""; }
        public void MarkDynamic() { }
        public void Clear() { }
        public void RecalculateBounds() { }
    }
    public class Transform : Object { public Quaternion localRotation { get; set; } }
    public class MonoBehaviour : Object
    {
        public Transform transform { get { return null; } }
        public T GetComponent<T>() { return default(T); }
    }
    public class MeshFilter : Object { public Mesh sharedMesh { get; set; } }
    public class MeshRenderer : Object { }
    public class SkinnedMeshRenderer : Object
    {
        public Mesh sharedMesh { get { return null; } }
        public void SetBlendShapeWeight(int shape, float weight) { }
    }
    public sealed class RequireComponent : System.Attribute { public RequireComponent(System.Type a, System.Type b) { } }
    public sealed class TooltipAttribute : System.Attribute { public TooltipAttribute(string words) { } }
}
