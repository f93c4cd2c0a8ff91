import sys
sys.path.insert(0,"/tmp/e60")
from exp1 import *
def binv(x,f):
    n=x.shape[0]//f
    return x[:n*f,:n*f,:n*f].reshape(n,f,n,f,n,f).mean((1,3,5)).astype(np.float32)
def lev(A,f): return A.on(A.grid.with_voxels(f*A.grid.voxel,0*A.grid.voxel),A.geometry.binned(f,f))
if __name__=="__main__":
  for seed in map(int,sys.argv[2:]):
      s=random_scan(seed,int(sys.argv[1]),CACHE); A=s.A
      nv=float(noise_var(s.p,s.photons).mean()); mua=s.mu*float(A.grid.voxel.mean())
      x=sart(A,s.p,iterations=4,relaxation=1.0,nonnegative=True).array
      # clean residual of truth, per level, in units of (mu a_level)^2
      line=[f"{seed} {s.family:10s} noise/(mua)^2 {nv/mua**2:.3f}"]
      for f in (1,2,4):
          Ac=lev(A,f) if f>1 else A
          pc=binned(s.p,None,(f,f))[0] if f>1 else s.p
          r=Ac(binv(s.truth,f) if f>1 else s.truth)-pc
          rt=float(np.mean(np.square(r)))-nv/f**2
          line.append(f"R_t{f} {rt/(f*mua)**2:.3f}")
      Ax=A(x)
      for f in (2,4):
          Ac=lev(A,f); r=Ac(binv(x,f))-binned(Ax,None,(f,f))[0]
          line.append(f"est{f} {float(np.mean(np.square(r)))/(f*mua)**2:.3f}")
      At=A(s.truth)
      for f in (2,4):
          Ac=lev(A,f); r=Ac(binv(s.truth,f))-binned(At,None,(f,f))[0]
          line.append(f"estTruth{f} {float(np.mean(np.square(r)))/(f*mua)**2:.3f}")
      # gradient model
      for f,xx in ((1,s.truth),(1,x)):
          a=float(A.grid.voxel.mean()); g=np.gradient(xx.astype(np.float64),a); g2=(g[0]**2+g[1]**2+g[2]**2).astype(np.float32)
          line.append(f"A(|grad|^2 a^3) {float(A(g2).mean())*a**3/mua**2:.3f}")
      print(" ".join(line),flush=True)
  